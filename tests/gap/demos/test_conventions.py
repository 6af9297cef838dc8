"""Recorded demonstrations whose numbers mean something else than the simulator's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from task_recordings import EPISODES, plain_log, record, rollouts

from rlco.errors import DataError
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.demos.conventions import check as checks
from rlco.gap.demos.conventions.action_units import read_gripper
from rlco.gap.demos.conventions.actions import (
    ActionConvention,
    Motion,
    score,
    scores,
    size,
)
from rlco.gap.demos.conventions.check import Conventions, check_conventions
from rlco.gap.demos.conventions.nominal_response import nominal_responses
from rlco.gap.demos.conventions.states import StateConvention, read_state
from rlco.gap.demos.replay.task_space import TaskSpaceProblem
from rlco.gap.logs.log import Log, Recording
from rlco.physics.effects import AppliedEffect
from rlco.physics.spec.names import STATE_NAMES
from rlco.physics.spec.robot import PANDA
from rlco.physics.tasks.push_cube import TASK

Array = NDArray[np.float64]
Change = Callable[[Array, Array], Array]
DOWN = Rotation.from_matrix(PANDA.down)


def check(log: Log) -> Conventions:
    return check_conventions(TASK, log, rollouts=rollouts())


@cache
def short() -> Log:
    return Log(plain_log().recordings[:2])


def state_of(recording: Recording) -> Array:
    return np.stack([recording.extra[name] for name in STATE_NAMES], axis=1)


def turns_of(state: Array) -> Rotation:
    return Rotation.from_rotvec(state[:, 3:6]) * DOWN


def with_actions(change: Change) -> Log:
    """The log with other actions, made from actions (T, 7) and states (T, 7)."""
    return Log(
        tuple(
            replace(r, command=change(np.array(r.command), state_of(r)))
            for r in short().recordings
        )
    )


def with_states(change: Callable[[Array], Array]) -> Log:
    """The log with other states, whose columns bear no names of ours."""
    recordings = []
    for recording in short().recordings:
        rows = change(state_of(recording))
        extra = {k: v for k, v in recording.extra.items() if k not in STATE_NAMES}
        named = {f"state.{i}": column for i, column in enumerate(rows.T)}
        recordings.append(replace(recording, extra=named | extra))
    return Log(tuple(recordings))


# -- What people do to actions ------------------------------------------------------


def flipped(action: Array, state: Array) -> Array:
    return action * np.array([1, -1, 1, 1, 1, 1, 1])


def changed_round(action: Array, state: Array) -> Array:
    return action[:, [1, 0, 2, 3, 4, 5, 6]] * np.array([1, -1, 1, 1, 1, 1, 1])


def along_the_tool(action: Array, state: Array) -> Array:
    axes = turns_of(state).as_matrix()
    moves, turns = (
        np.einsum("tji,tj->ti", axes, action[:, part])
        for part in (slice(0, 3), slice(3, 6))
    )
    return np.concatenate([moves, turns, action[:, 6:]], axis=1)


def as_targets(action: Array, state: Array) -> Array:
    turned = Rotation.from_rotvec(0.5 * action[:, 3:6])
    turned = turned * Rotation.from_rotvec(state[:, 3:6])
    place = state[:, :3] + 0.05 * action[:, :3]
    return np.concatenate([place, turned.as_rotvec(), action[:, 6:]], axis=1)


def in_metres(action: Array, state: Array) -> Array:
    return action * np.array([0.05] * 3 + [0.5] * 3 + [1.0])


def in_parts_of_ten_centimetres(action: Array, state: Array) -> Array:
    return action * np.array([0.5] * 3 + [1.0] * 4)


def a_row_late(action: Array, state: Array) -> Array:
    return np.concatenate([np.zeros((1, 7)), action[:-1]])


CHANGES: dict[str, tuple[Change, str]] = {
    "sign": (flipped, "translations have the sign of y flipped"),
    "axes": (changed_round, "translations have x, y, z as their -y, x, z"),
    "tool": (along_the_tool, "translations are along the tool's axes, not the base's"),
    "absolute": (
        as_targets,
        "translations are absolute targets, not relative motions",
    ),
    "metres": (in_metres, "translations are in metres, not in parts of 0.05 m"),
    "late": (a_row_late, "each row holds the action that preceded it"),
}


@pytest.mark.slow
def test_the_simulators_own_log_agrees() -> None:
    found = check(short())
    assert found.agrees
    assert found.apply(short()) is short()
    assert found.error < 2e-3
    assert found.summary.startswith("The log follows the simulator's conventions: ")


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_another_convention_of_actions_is_recognised_and_corrected(name: str) -> None:
    change, words = CHANGES[name]
    log = with_actions(change)
    found = check(log)
    assert not found.agrees
    assert any(words in phrase for phrase in found.changes)
    assert found.error < 2e-3
    assert found.error_as_is is not None
    assert found.error_as_is > 3.0 * found.error
    corrected = found.apply(log)
    for ours, theirs in zip(corrected.recordings, short().recordings, strict=True):
        assert ours.command is not None
        assert theirs.command is not None
        rows = len(ours.command)
        assert np.allclose(ours.command, theirs.command[:rows], atol=2e-5)


# -- And to states ------------------------------------------------------------------


def quaternions(order: str) -> Callable[[Array], Array]:
    def change(state: Array) -> Array:
        turn = turns_of(state).as_quat(scalar_first=order == "wxyz")
        return np.concatenate([state[:, :3], turn, state[:, 6:]], axis=1)

    return change


def from_the_world_in_millimetres(state: Array) -> Array:
    place = 1e3 * (state[:, :3] + PANDA.base)
    return np.concatenate([place, state[:, 3:]], axis=1)


def from_the_axes_in_degrees(state: Array) -> Array:
    turn = np.rad2deg(turns_of(state).as_euler("xyz"))
    half = state[:, 6:] / 2.0
    return np.concatenate([state[:, :3], turn, half, -half], axis=1)


@pytest.mark.parametrize(
    ("change", "convention"),
    [
        (quaternions("wxyz"), StateConvention(rotation="wxyz", zero="axes")),
        (quaternions("xyzw"), StateConvention(rotation="xyzw", zero="axes")),
        (
            from_the_world_in_millimetres,
            StateConvention(frame="world", unit="millimetres"),
        ),
        (
            from_the_axes_in_degrees,
            StateConvention(rotation="euler", zero="axes", degrees=True),
        ),
    ],
    ids=["wxyz", "xyzw", "world", "euler"],
)
def test_another_way_to_write_states_is_recognised(
    change: Callable[[Array], Array], convention: StateConvention
) -> None:
    log = with_states(change)
    measured = [np.stack(list(r.extra.values()), 1) for r in log.recordings]
    size = change(state_of(short().recordings[0])).shape[1]
    _, home = nominal_responses(rollouts())
    assert read_state([rows[:, :size] for rows in measured], home) == [convention]


def test_states_are_written_as_the_simulator_writes_them() -> None:
    log = with_states(quaternions("xyzw"))
    found = check(log)
    assert "rotations are quaternions (x, y, z, w)" in found.changes
    assert found.error < 2e-3
    for ours, theirs in zip(
        found.apply(log).recordings, short().recordings, strict=True
    ):
        assert np.allclose(state_of(ours), state_of(theirs), atol=1e-6)


def test_a_robot_elsewhere_is_refused() -> None:
    log = with_states(lambda state: state + np.array([0.9, 0, 0, 0, 0, 0, 0]))
    with pytest.raises(DataError, match="starts far from the initial poses"):
        check(log)


# -- What is no convention, and what cannot be inferred ------------------------------


def test_a_late_robot_is_no_other_convention() -> None:
    """A delay may be the robot's: it is said, and left to command_delay."""
    log = with_actions(lambda a, s: np.concatenate([a[1:], np.zeros((1, 7))]))
    found = check(log)
    assert found.agrees
    assert found.moves.lead == -1
    assert "command_delay" in found.summary


@pytest.mark.slow
def test_a_robot_with_friction_and_payload_still_agrees() -> None:
    from rlco.physics.native.stepper import NativeStepper
    from rlco.physics.spec.domain import SIM

    hidden = [
        AppliedEffect("coulomb_friction", "robot0_joint2", {"frictionloss": 5.0}),
        AppliedEffect(
            "payload",
            "gripper0_right_right_gripper",
            {"mass": 0.5, "x": 0.0, "y": 0.0, "z": 0.05},
        ),
    ]
    robot = NativeStepper(TASK, SIM, num_envs=EPISODES, threads=1, effects=hidden)
    found = check(Log(record(robot=robot)[0].recordings[:2]))
    assert found.agrees
    assert found.error > 3e-3


@pytest.mark.thorough
def test_a_unit_of_a_size_of_its_own_is_fitted() -> None:
    found = check(with_actions(in_parts_of_ten_centimetres))
    assert found.changes == (
        "one unit of translations moves the tool by 0.1 m, not 0.05",
    )
    assert found.move_scale.size == pytest.approx(0.1, rel=1e-3)
    assert found.error < 2e-3


def test_replays_that_diverge_fit_no_size(monkeypatch: pytest.MonkeyPatch) -> None:
    # No recording is known that diverges with larger actions alone.
    lost = np.full((10, 3), np.inf)
    monkeypatch.setattr(checks, "_misses", lambda log, rollouts: (lost, lost))
    found = check(with_actions(in_parts_of_ten_centimetres))
    assert found.move_scale.size == 0.05
    assert found.error == np.inf


@pytest.mark.thorough
def test_a_robot_that_a_damping_slows_has_units_of_the_same_size() -> None:
    # Its tool moves by 0.6 of what is commanded, and actions of 0.6 of their size are
    # replayed better; but that leaves centimetres, which the damping explains.
    from rlco.physics.native.stepper import NativeStepper
    from rlco.physics.spec.domain import SIM

    damping = AppliedEffect("viscous_damping", "robot0_joint4", {"damping": 20.0})
    robot = NativeStepper(TASK, SIM, num_envs=EPISODES, threads=1, effects=[damping])
    log = Log(record(robot=robot)[0].recordings[:2])
    found = check(log)
    assert found.agrees
    assert "one unit of translations moves the tool by 0.03" in found.summary
    problem = TaskSpaceProblem(TASK, found.apply(log), rollouts=rollouts())
    (rows,) = problem.residuals([Hypothesis((damping,))])
    scaled = rows / problem.noise[problem.layout.channel]
    assert np.sqrt(np.mean(scaled**2)) < 1.5


def test_a_hand_that_never_moves_tells_nothing_of_its_number() -> None:
    half_open = np.full(40, 0.04)
    assert not read_gripper([np.full(40, 1.0)], [half_open]).observed
    shut = read_gripper([np.full(40, 1.0)], [np.zeros(40)])
    assert (shut.observed, shut.closes) == (True, "high")


def test_a_gripper_from_zero_to_one_that_closes_at_zero() -> None:
    number = np.repeat([1.0, 0.0, 1.0], 20)
    opening = np.interp(
        np.arange(60), [0, 20, 30, 40, 50, 60], [0.08] * 2 + [0] * 2 + [0.08] * 2
    )
    found = read_gripper([number], [opening])
    assert (found.observed, found.closes, found.low) == (True, "low", 0.0)
    assert found.simulated(np.array([0.0, 1.0])).tolist() == [1.0, -1.0]


def test_actions_of_another_recording_explain_nothing() -> None:
    rng = np.random.default_rng(0)
    log = with_actions(lambda a, s: rng.uniform(-1.0, 1.0, a.shape))
    found = check(log)
    assert found.explained < 0.2
    assert found.summary.startswith("No convention of the actions explains")


# -- The arithmetic -------------------------------------------------------------------


def answering(keep: float, gain: float, worth: float) -> tuple[Motion, Array]:
    """A tool that answers exactly so to numbers along (y, -x, z)."""
    asked = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 3))
    meant = worth * asked[:, [1, 0, 2]] * np.array([1.0, -1.0, 1.0])
    moved = np.zeros((200, 3))
    for row in range(1, 200):
        moved[row] = keep * moved[row - 1] + gain * meant[row]
    place = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)[:-1]])
    turn = np.tile(np.eye(3), (200, 1, 1))
    return Motion(asked, asked, place, turn), moved


def test_an_exact_answer_is_explained_exactly() -> None:
    motion, _ = answering(keep=0.5, gain=0.2, worth=0.04)
    best = scores([motion])[0]
    assert best.convention == ActionConvention(axes=("+y", "-x", "+z"))
    assert best.explained == pytest.approx(1.0)
    assert best.keep == pytest.approx(0.5)
    assert best.gain == pytest.approx(0.2 * 0.04)


def test_a_numbers_worth_is_told_by_how_a_known_tool_answers() -> None:
    motion, _ = answering(keep=0.5, gain=0.2, worth=0.04)
    known, _ = answering(keep=0.5, gain=0.2, worth=1.0)
    convention = ActionConvention(axes=("+y", "-x", "+z"))
    nominal = score([known], convention)
    assert size([motion], convention, nominal) == pytest.approx(0.04)
