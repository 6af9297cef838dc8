"""Frames of a task's worlds by its cameras, in the look of their domain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.physics.rendering.camera import Quality, camera_id
from rlco.physics.rendering.exposure import ROW, expose_range, exposure_row
from rlco.physics.rendering.renderers import Frames, check_renderer, frames_of
from rlco.physics.robosuite.scene_look import SceneLook
from rlco.physics.spec.look import Look, View
from rlco.physics.spec.look_ranges import LookRanges
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.stepper import Stepper
from rlco.physics.spec.streams import Stream

Images = NDArray[np.uint8]
Integers = NDArray[np.int64]
# Odd numbers by which keys of frames differ in time, and from camera to camera.
_IN_TIME, _BESIDE = np.uint64(0xD1342543DE82EF95), np.uint64(0xAF251AF3B0F025B5)


class Views:
    """The current frames of N worlds by named cameras.

    The scene of a `Look` is compiled into the stepper's model; what its lens and sensor
    do is added to each frame here. With `LookRanges` each episode has a look of its
    own, which depends on nothing but its seed and number.

    Args:
        stepper: The worlds, built in a domain of that look.
        look: The domain's.
        image_size: Height and width of frames [pixels].
        cameras: Names of the model's cameras.
        renderer: ``raster`` or ``opengl``.
        quality: Of ``opengl``: ``fast`` or ``robosuite``.

    Attributes:
        images: By camera, uint8 (N, 3, height, width); valid after `draw`.

    Raises:
        RenderingError: If there is no OpenGL library to render with.
        UnknownNameError: If the model has no such camera, or a name is unknown.
        RlcoError: If a camera is named twice or none is, or the renderer has no such
            quality.
    """

    def __init__(
        self,
        stepper: Stepper,
        look: Look | LookRanges,
        image_size: tuple[int, int],
        *,
        cameras: Sequence[str] = ("agentview",),
        renderer: Renderer = "opengl",
        quality: Quality = "fast",
    ) -> None:
        check_cameras(cameras)
        check_renderer(renderer, quality)
        for name in cameras:  # all of them before anything is made
            camera_id(stepper.model, name)
        count = len(stepper.data)
        self._stepper, self._size = stepper, image_size
        self._ranges = look if isinstance(look, LookRanges) else None
        self._scene = SceneLook(stepper.model) if self._ranges else None
        self._frames: dict[str, Frames] = {
            name: frames_of(
                stepper, image_size, name=name, renderer=renderer, quality=quality
            )
            for name in cameras
        }
        self.images: dict[str, Images] = {
            name: np.zeros((count, 3, *image_size), np.uint8) for name in cameras
        }
        self._keys = np.zeros(count, np.uint64)
        self._exposed = np.zeros(count, np.bool_)
        self._rows = {name: np.zeros((count, ROW), np.float32) for name in cameras}
        if isinstance(look, Look):
            self._expose(np.arange(count), look)

    def start(self, which: Integers, seed: int, episodes: Sequence[int]) -> None:
        """Give the worlds `which` the looks of the episodes that they are to start.

        Call it before the worlds are reset: a camera is where it is from then on.

        Args:
            which: Indices of worlds, shape (R,).
            seed: Of the episodes.
            episodes: Their numbers, one for each of `which`.
        """
        for world, episode in zip(which.tolist(), episodes, strict=True):
            pixels = np.random.SeedSequence([seed, episode, Stream.PIXELS])
            self._keys[world] = pixels.generate_state(1, np.uint64)[0]
            if self._ranges is None or self._scene is None:
                continue
            one = np.array([world])
            rng = np.random.default_rng([seed, episode, Stream.LOOK])
            look = self._ranges.draw(rng)
            fields = self._scene.fields(look)
            self._stepper.patch(one, {k: v[None] for k, v in fields.items()})
            self._expose(one, look)

    def _expose(self, which: Integers, look: Look) -> None:
        """Keep what a look's lens and sensor do to the frames of the worlds `which`."""
        self._exposed[which] = look.changes_frames
        for name, rows in self._rows.items():
            view = look.cameras.get(name, View())
            rows[which] = exposure_row(look, view, self._size)

    def draw(self, which: Integers, elapsed: Integers) -> None:
        """Render the current frames of the worlds `which`.

        Args:
            which: Indices of worlds, shape (R,).
            elapsed: Control steps since the start of each world's episode, (N,): a
                frame's noise depends on the episode and on them.
        """
        exposed = which[self._exposed[which]]
        keys = self._keys + elapsed.astype(np.uint64) * _IN_TIME
        for number, (name, frames) in enumerate(self._frames.items()):
            images = self.images[name]
            frames.draw(which, images)
            if exposed.size:
                self._stepper.run_over(
                    expose_range,
                    exposed.size,
                    exposed,
                    self._rows[name],
                    # Of an array, where a product that wraps around is no mistake.
                    keys + np.array([number], np.uint64) * _BESIDE,
                    images,
                )

    def close(self) -> None:
        """Free what was kept to render."""
        for frames in self._frames.values():
            frames.close()


def check_cameras(cameras: Sequence[str]) -> None:
    """Refuse no camera, and one that is named twice.

    Raises:
        RlcoError: If that is so.
    """
    names = tuple(cameras)
    if isinstance(cameras, str) or not names or len(set(names)) < len(names):
        raise RlcoError(
            f"cameras={cameras!r} is not allowed; give a list of names of cameras, "
            "each once, such as ['agentview', 'robot0_eye_in_hand']."
        )
