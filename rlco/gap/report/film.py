"""A film of a few seconds: the robot as measured, and as two models move it.

The measured robot is solid. The two simulated ones are tinted copies of it, which show
where they are elsewhere; their outlines are on top of all. Differences of a few
milliradians are less than a pixel, so that they are enlarged where needed, by a factor
that the frame names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rlco.errors import RlcoError
from rlco.gap.compare.wording import number, scale_of
from rlco.gap.correct.corrected_files import whole_spec
from rlco.gap.diagnose.filmed import Filmed
from rlco.gap.logs.log import Array
from rlco.gap.model import LoadedModel
from rlco.gap.report.figures import CORRECTED, MEASURED, NOMINAL
from rlco.gap.report.film_scene import FilmScene, NothingToDrawError, Pose
from rlco.reporting.plot_style import INK, QUIET
from rlco.reporting.video import mp4

#: Bytes of a film at most; it is in the report's page.
LARGEST = 2_000_000
RATE = 12  # frames per second
WIDTH, SCENE, TOP, BELOW = 560, 300, 64, 128  # of the frame and its parts [pixels]
_FINE = 2  # pixels drawn for each shown, along a side
_ENLARGED = (1, 2, 5, 10, 20, 50)
_SEEN = 0.08  # share of the robot's size that a difference should move it
_POSES = 25  # poses that place the camera
_TINT, _EDGE = 0.6, 0.9  # how opaque a copy is, and its outline
_QUALITIES = (21, 26, 31, 38)
_PAPER = (250.0, 251.0, 252.0)


@dataclass(frozen=True)
class Film:
    """A film and what it shows.

    Attributes:
        content: The mp4 file.
        caption: What is to be seen, in words.
    """

    content: bytes
    caption: str


def film_of(loaded: LoadedModel, shown: Filmed | str | None) -> Film | str:
    """Return the film of a report, or why there is none; nothing if none is wanted.

    Args:
        loaded: The user's model.
        shown: The motion to show, or why there is none.
    """
    if shown is None or isinstance(shown, str):
        return shown or ""
    return make_film(whole_spec(loaded), shown)


def make_film(spec: mujoco.MjSpec, shown: Filmed) -> Film | str:
    """Return the film of a few seconds, or why there is none.

    Args:
        spec: The user's whole model, with meshes.
        shown: The motion.
    """
    try:
        scene = FilmScene(spec, shown.joints, (_FINE * SCENE, _FINE * WIDTH))
    except NothingToDrawError:
        return (
            "There is no film: the model has no geoms or meshes on its moving links, "
            "so there is no robot to draw."
        )
    except (ValueError, RlcoError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        return f"There is no film: the model cannot be drawn ({reason})."
    moments = np.arange(shown.time[0], shown.time[-1], 1.0 / RATE)
    if len(moments) < 2:
        return "There is no film: the seconds to show are too few."
    tracks = [shown.measured, shown.nominal]
    tracks += [] if shown.corrected is None else [shown.corrected]
    played = [_at(moments, shown.time, track) for track in tracks]
    factor = _enlargement(scene, played[0], played[1])
    ghosts = [played[0] + factor * (track - played[0]) for track in played[1:]]
    some = np.unique(np.linspace(0, len(moments) - 1, _POSES).astype(int))
    away = [scene.moved_by(played[0][i], ghosts[0][i]) for i in some]
    scene.look([track[some] for track in (played[0], *ghosts)], np.concatenate(away))
    panel = _Panel(shown, tracks, factor)
    frames = np.stack(
        [
            panel.picture(
                float(moment),
                scene.draw(played[0][i]),
                [scene.draw(ghost[i]) for ghost in ghosts],
            )
            for i, moment in enumerate(moments)
        ]
    )
    for quality in _QUALITIES:
        content = mp4(frames, RATE, quality=quality)
        if len(content) < LARGEST:
            break
    return Film(content, panel.caption())


def _at(moments: Array, time: Array, track: Array) -> Array:
    """Return a track (T, joints) at other moments."""
    columns = [np.interp(moments, time, column) for column in track.T]
    return np.stack(columns, axis=1)


def _enlargement(scene: FilmScene, measured: Array, nominal: Array) -> int:
    """Return the factor by which differences are enlarged to be seen."""
    distance = np.abs(nominal - measured).max(axis=1)
    at = int(np.argmax(distance))
    corners = scene.corners(measured[at]).reshape(-1, 3)
    size = float(np.linalg.norm(np.ptp(corners, axis=0)))
    away = np.linalg.norm(scene.moved_by(measured[at], nominal[at]), axis=1)
    enough = _SEEN * size / max(float(away.max()), 1e-12)
    return next((f for f in _ENLARGED if f >= enough), _ENLARGED[-1])


class _Panel:
    """The frame around the robot: a legend above, the joint's track below."""

    def __init__(self, shown: Filmed, tracks: Sequence[Array], factor: int) -> None:
        self._shown, self._factor = shown, factor
        self._names = ("measured", "model before", "model corrected")[: len(tracks)]
        self._colours = (MEASURED, NOMINAL, CORRECTED)[: len(tracks)]
        measured = tracks[0][:, shown.shown]
        columns = [track[:, shown.shown] - measured for track in tracks]
        self._unit, scale = scale_of(shown.unit, float(np.abs(columns).max()))
        self._columns = [column * scale for column in columns]
        low, high = float(np.min(self._columns)), float(np.max(self._columns))
        room = 0.08 * (high - low) or 1.0
        self._range = low - room, high + room
        self._axes = (64.0, 12.0, WIDTH - 20.0, BELOW - 26.0)
        self._top, self._below = self._legend(), self._plot()

    def caption(self) -> str:
        """Return what the film shows, in words."""
        shown = self._shown
        held = ", which was held out of the fit" if shown.heldout else ""
        seconds = f"{shown.time[0]:.1f} to {shown.time[-1]:.1f} s"
        words = (
            f"The robot in {seconds} of recording {shown.recording}{held}: solid as "
            "measured, tinted as the models move it, from the commands of the "
            "recording. "
        )
        words += (
            "Differences are as they are."
            if self._factor == 1
            else f"Differences from the measured robot are drawn {self._factor} times "
            "as large as they are."
        )
        joint = shown.joints[shown.shown]
        return f"{words} Below, the residual at joint {joint}, not enlarged."

    def picture(
        self, moment: float, measured: Pose, ghosts: Sequence[Pose]
    ) -> NDArray[np.uint8]:
        """Return one frame, (height, width, 3)."""
        scene = _overlaid(measured, ghosts, self._colours)
        below = Image.fromarray(self._below)
        draw = ImageDraw.Draw(below)
        x = self._x(moment)
        draw.line([(x, self._axes[1]), (x, self._axes[3])], fill=INK, width=1)
        for column, colour in zip(
            reversed(self._columns), reversed(self._colours), strict=True
        ):
            y = self._y(float(np.interp(moment, self._shown.time, column)))
            draw.ellipse([x - 4, y - 4, x + 4, y + 4], fill=colour)
        return np.concatenate([self._top, scene, np.asarray(below)])

    def _x(self, time: float) -> float:
        first, last = self._shown.time[0], self._shown.time[-1]
        left, _, right, _ = self._axes
        return float(left + (right - left) * (time - first) / (last - first))

    def _y(self, value: float) -> float:
        low, high = self._range
        _, top, _, bottom = self._axes
        return float(bottom - (bottom - top) * (value - low) / (high - low))

    def _legend(self) -> NDArray[np.uint8]:
        image = Image.new("RGB", (WIDTH, TOP), "white")
        draw = ImageDraw.Draw(image)
        x = 20.0
        for name, colour in zip(self._names, self._colours, strict=True):
            draw.rectangle([x, 15, x + 16, 31], fill=colour)
            draw.text((x + 24, 23), name, fill=INK, font=_font(16), anchor="lm")
            x += 24 + draw.textlength(name, font=_font(16)) + 28
        words = (
            "true to scale"
            if self._factor == 1
            else f"differences enlarged {self._factor} times"
        )
        held = ", held out" if self._shown.heldout else ""
        name = _short(self._shown.recording, 40)
        text = f"{words} · recording {name}{held}"
        draw.text((20, 50), text, fill=QUIET, font=_font(13), anchor="lm")
        return np.asarray(image)

    def _plot(self) -> NDArray[np.uint8]:
        """Return the joint's tracks, drawn finer than shown and then reduced."""
        fine = 3
        image = Image.new("RGB", (fine * WIDTH, fine * BELOW), "white")
        draw = ImageDraw.Draw(image)
        left, top, right, bottom = self._axes
        frame = [fine * v for v in (left, top, right, bottom)]
        draw.rectangle(frame, outline="#d9dde1", width=fine)
        for column, colour in zip(
            reversed(self._columns), reversed(self._colours), strict=True
        ):
            points = [
                (fine * self._x(float(t)), fine * self._y(float(v)))
                for t, v in zip(self._shown.time, column, strict=True)
            ]
            draw.line(points, fill=colour, width=2 * fine, joint="curve")
        image = image.resize((WIDTH, BELOW), Image.Resampling.BOX)
        draw = ImageDraw.Draw(image)
        low, high = min(map(np.min, self._columns)), max(map(np.max, self._columns))
        for value in (float(low), float(high)):
            y = min(max(self._y(value), top + 6), bottom - 6)
            text = number(value)
            draw.text((left - 8, y), text, fill=QUIET, font=_font(12), anchor="rm")
        joint = _short(self._shown.joints[self._shown.shown], 40)
        words = f"{joint}, simulated minus measured [{self._unit}]"
        first, last = self._shown.time[0], self._shown.time[-1]
        for x, text, anchor in (
            (left, f"{first:.1f} s", "lm"),
            ((left + right) / 2, words, "mm"),
            (right, f"{last:.1f} s", "rm"),
        ):
            place = (x, bottom + 13)
            draw.text(place, text, fill=QUIET, font=_font(13), anchor=anchor)
        return np.asarray(image)


def _overlaid(
    measured: Pose, ghosts: Sequence[Pose], colours: Sequence[str]
) -> NDArray[np.uint8]:
    """Return the robots over each other, (height, width, 3), at the shown size."""
    height, width = (size // _FINE for size in measured.shade.shape)
    whole = np.full((height, width, 3), _PAPER, np.uint8)
    seen = measured.robot | np.logical_or.reduce([ghost.moving for ghost in ghosts])
    rows, columns = _around(seen.any(axis=1)), _around(seen.any(axis=0))
    measured = _cut(measured, rows, columns)
    image = np.full((*measured.shade.shape, 3), _PAPER, np.float32)
    edges = []
    for uncut, colour in zip(ghosts, colours[1:], strict=True):
        ghost, tint = _cut(uncut, rows, columns), np.array(_rgb(colour), np.float32)
        mine, edge = ghost.moving, ghost.moving & ~_shrunk(ghost.moving)
        lit = np.minimum(tint * (0.75 + 0.5 * ghost.shade[mine][:, None]), 255.0)
        image[mine] += _TINT * (lit - image[mine])
        edges.append((edge, tint))
    solid = measured.robot
    image[solid] = 40.0 + 150.0 * measured.shade[solid][:, None]
    for edge, tint in edges:
        image[edge] += _EDGE * (tint - image[edge])
    size = image.shape[0] // _FINE, _FINE, image.shape[1] // _FINE, _FINE, 3
    shown = image.reshape(size).mean(axis=(1, 3)) + 0.5
    at = slice(rows.start // _FINE, rows.stop // _FINE)
    whole[at, columns.start // _FINE : columns.stop // _FINE] = shown
    return whole


def _around(seen: NDArray[np.bool_]) -> slice:
    """Return the range of what is seen, in whole pixels of the frame."""
    places = np.flatnonzero(seen)
    if not places.size:
        return slice(0, 0)
    return slice(places[0] // _FINE * _FINE, (places[-1] // _FINE + 1) * _FINE)


def _cut(pose: Pose, rows: slice, columns: slice) -> Pose:
    at = rows, columns
    return Pose(pose.shade[at], pose.robot[at], pose.moving[at])


def _shrunk(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask without the pixels at its edge, two wide."""
    inner = mask.copy()
    for _ in range(2):
        kept = inner.copy()
        kept[1:] &= inner[:-1]
        kept[:-1] &= inner[1:]
        kept[:, 1:] &= inner[:, :-1]
        kept[:, :-1] &= inner[:, 1:]
        inner = kept
    return inner


def _rgb(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"


@cache
def _font(size: int) -> Any:
    # Matplotlib brings this one along: the same picture on any machine.
    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)
