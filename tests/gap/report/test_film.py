"""The film of a report: what can be read from its frames."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import av
import mujoco
import numpy as np
import pytest
from small_problems import ARM, Arm, arm_problem
from small_verdicts import DAMPING, FRICTION, named

from rlco.gap.diagnose.filmed import Filmed, filmed
from rlco.gap.diagnose.traces import best_stretches
from rlco.gap.report import film
from rlco.gap.report.film import Film, make_film
from rlco.gap.report.film_scene import FilmScene


@pytest.fixture
def problem() -> Arm:
    return arm_problem(FRICTION, DAMPING)


JOINTS = ("shoulder", "elbow")
TIME = np.linspace(3.0, 3.5, 26)


def motion(nominal: float, corrected: float | None) -> Filmed:
    """Return half a second in which models are so far off at the elbow [rad]."""
    measured = np.stack([0.2 * np.sin(4 * TIME), 0.3 * np.cos(4 * TIME)], axis=1)
    off = np.array([0.0, 1.0])
    return Filmed(
        recording="take_3",
        heldout=True,
        joints=JOINTS,
        shown=1,
        unit="rad",
        time=TIME,
        measured=measured,
        nominal=measured + nominal * off,
        corrected=None if corrected is None else measured + corrected * off,
    )


def spec() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(ARM)


def played(shown: Filmed) -> tuple[Film, np.ndarray]:
    """Return a film and its frames, (T, height, width, 3)."""
    made = make_film(spec(), shown)
    assert isinstance(made, Film)
    with av.open(io.BytesIO(made.content)) as container:
        (stream,) = container.streams.video
        assert stream.codec_context.name == "h264"
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode()]
    return made, np.stack(frames)


def like(frame: np.ndarray, colour: str) -> int:
    """Return how many pixels of the scene have about a hue."""
    part = frame[film.TOP : film.TOP + film.SCENE].astype(float)
    red, green, blue = np.moveaxis(part, -1, 0)
    if colour == "orange":
        return int(((red > green + 40) & (green > blue + 20)).sum())
    return int(((green > red + 40) & (green > blue)).sum())


def rows_like(part: np.ndarray, colour: str) -> np.ndarray:
    """Return the rows in which some pixel has about a colour, such as ``#ff0000``."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    near = np.abs(part.astype(float) - wanted).max(axis=-1) < 40
    return np.flatnonzero(near.any(axis=1))


@pytest.mark.slow
def test_each_model_is_seen_where_it_is_not_behind_the_robot() -> None:
    # 0.4 rad at the elbow of a 25 cm forearm: as they are, without enlargement.
    made, frames = played(motion(0.4, 0.0))
    assert len(frames) == 6  # half a second
    assert "held out" in made.caption
    assert "Differences are as they are." in made.caption
    middle = frames[3]
    assert like(middle, "orange") > 500
    # A model that moves as the robot does has no more than an outline.
    assert 0 < like(middle, "green") < 0.4 * like(middle, "orange")
    # Below, what is left of the first is at the top; what measures zero, at the bottom.
    plot = middle[film.TOP + film.SCENE :]
    assert rows_like(plot, film.NOMINAL).max() < rows_like(plot, film.MEASURED).max()
    # The mark of the time is at a sixth of the plot's 476 pixels further each frame.
    inside = frames[:, film.TOP + film.SCENE + 14 : -28, 70 : film.WIDTH - 26]
    marks = 70 + inside.astype(float).sum(axis=(1, 3)).argmin(axis=1)
    np.testing.assert_allclose(marks[1:], 64 + 476 * np.arange(1, 6) / 6, atol=1.0)
    _, swapped = played(motion(0.0, 0.4))
    plot = swapped[3, film.TOP + film.SCENE :]
    assert rows_like(plot, film.CORRECTED).max() < rows_like(plot, film.MEASURED).max()
    assert like(swapped[3], "green") > 500
    assert like(swapped[3], "orange") < 0.4 * like(swapped[3], "green")


@pytest.mark.slow
def test_small_differences_are_enlarged_and_the_film_says_so() -> None:
    made, frames = played(motion(0.02, None))
    # The lower arm of 27 cm moves by 5 mm; 8 % of the arm's 60 cm are 5 cm.
    assert "drawn 10 times as large as they are" in made.caption
    assert like(frames[3], "orange") > 100
    assert like(frames[3], "green") == 0


@pytest.mark.slow
def test_a_film_is_the_same_each_time_and_small(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, _ = played(motion(0.1, 0.01))
    again, _ = played(motion(0.1, 0.01))
    assert made == again
    assert len(made.content) < film.LARGEST / 10
    monkeypatch.setattr(film, "LARGEST", len(made.content) - 1)
    smaller, _ = played(motion(0.1, 0.01))
    assert len(smaller.content) < len(made.content)


def test_what_has_no_shape_has_a_sentence_instead() -> None:
    bare = mujoco.MjSpec.from_string(
        """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body>
        <joint name="shoulder"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body><joint name="elbow"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body>
        </worldbody></mujoco>"""
    )
    found = make_film(bare, motion(0.1, 0.0))
    assert found == (
        "There is no film: the model has no geoms or meshes on its moving links, so "
        "there is no robot to draw."
    )


def test_a_moment_is_no_film() -> None:
    whole = motion(0.1, None)
    short = replace(
        whole,
        time=whole.time[:4],  # 60 ms, less than a frame
        measured=whole.measured[:4],
        nominal=whole.nominal[:4],
    )
    said = make_film(spec(), short)
    assert said == "There is no film: the seconds to show are too few."


def test_only_the_robot_is_drawn_by_its_looks() -> None:
    whole = mujoco.MjSpec.from_string(ARM)
    whole.worldbody.add_geom(
        name="wall", size=[3, 0.1, 3], type=mujoco.mjtGeom.mjGEOM_BOX
    )
    lower = whole.body("lower")
    lower.add_geom(name="looks", size=[0.03, 0, 0], group=2)
    lower.add_geom(name="touches", size=[0.2, 0, 0], group=3)
    scene = FilmScene(whole, JOINTS, (60, 80))
    drawn = {
        scene.model.geom(i).name or f"geom {i}"
        for i in range(scene.model.ngeom)
        if scene.model.geom_group[i]
    }
    assert drawn == {"looks", "geom 1"}  # and the upper arm's only geom


def test_a_film_shows_the_window_of_the_first_effect(problem: Arm) -> None:
    verdict = named(problem)
    stretches = best_stretches(problem, verdict)
    found = filmed(problem, verdict, stretches)
    assert isinstance(found, Filmed)
    first = stretches[0]
    assert found.joints[found.shown] == first.channel == "elbow"
    assert found.heldout
    np.testing.assert_array_equal(found.time, first.time)
    np.testing.assert_array_equal(found.nominal[:, found.shown], first.nominal)
    assert found.corrected is not None
    np.testing.assert_array_equal(found.corrected[:, found.shown], first.corrected)


def test_torques_are_not_filmed(problem: Arm) -> None:
    verdict = named(problem)
    stretches = best_stretches(problem, verdict)
    layout = problem.layout
    problem.layout = replace(layout, units=("N m",) * len(layout.units))
    said = filmed(problem, verdict, stretches)
    assert isinstance(said, str)
    assert "joint positions were not compared" in said
    assert filmed(problem, verdict, []) is None


def test_a_simulation_that_diverges_is_not_filmed(
    problem: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    verdict = named(problem)
    stretches = best_stretches(problem, verdict)
    traces = problem.traces

    def diverging(*given: Any) -> dict[str, Any]:
        found = traces(*given)
        simulated = np.where(
            found["time"][:, None] > stretches[0].time[-1] - 0.1,
            np.nan,
            found["simulated"],
        )
        return {**found, "simulated": simulated}

    monkeypatch.setattr(problem, "traces", diverging)
    said = filmed(problem, verdict, stretches)
    assert said == ("There is no film: the simulation diverges in the seconds to show.")
