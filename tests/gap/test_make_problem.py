"""Which comparison fits a log, and what is said where none does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hidden_arms import FPS, TWO_LINKS, commands, record
from log_cases import ARM, arm, motion, urdf, write_csv, write_lerobot

from rlco.errors import DataError
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs import read_log
from rlco.gap.make_problem import make_problem
from rlco.gap.model import load_model
from rlco.gap.search.steps.start import split
from rlco.physics.effects import AppliedEffect

TIME, POSITION, COMMAND = motion()
HOME = np.array([0.0, 0.2, 0.0, -2.0, 0.0, 2.6, 0.8])


def joint_log(tmp_path: Path, count: int, name: str) -> Path:
    """Write positions and commands of a Panda's first joints, named alike."""
    names = [f"{name}{i + 1}" for i in range(count)]
    moves = 0.2 * np.sin(TIME[:, None] + np.arange(count))
    position = HOME[:count] + moves
    joints = [f"joint{i + 1}" for i in range(count)]
    parts = {"observation.state": (joints, [position]), "action": (names, [position])}
    return write_lerobot(tmp_path / "set", parts)


@pytest.mark.parametrize("count", [3, 7])
def test_joint_commands_are_no_actions_of_a_task(tmp_path: Path, count: int) -> None:
    loaded = load_model("robosuite:push_cube")
    log = read_log(joint_log(tmp_path, count, "joint"), loaded)
    with pytest.raises(DataError, match=f"the log's {count} actions") as raised:
        make_problem(loaded, log)
    told = str(raised.value)
    assert "are commands of joints, neither the 7 actions of task 'push_cube'" in told
    assert "tool.dx, tool.dy" in told
    assert "an MJCF file with a position servo" in told


def test_actions_that_are_nobodys(tmp_path: Path) -> None:
    loaded = load_model("robosuite:Lift")
    log = read_log(joint_log(tmp_path, 3, "motor"), loaded)
    match = r"\(motor1, motor2, motor3\) are not those of model 'Lift', which has 9"
    with pytest.raises(DataError, match=match):
        make_problem(loaded, log)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_urdf_is_compared_by_its_torques(tmp_path: Path, sign: float) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf())
    model = mujoco.MjModel.from_xml_path(str(file))
    position = 0.5 * np.sin(TIME[:, None] * [2.0, 3.0])
    speed = np.gradient(position, TIME, axis=0)
    pull = np.gradient(speed, TIME, axis=0)
    data, torque = mujoco.MjData(model), np.empty_like(position)
    for row in range(len(TIME)):
        data.qpos[:], data.qvel[:], data.qacc[:] = position[row], speed[row], pull[row]
        mujoco.mj_inverse(model, data)
        torque[row] = data.qfrc_inverse
    columns = {"time": TIME}
    for i, name in enumerate(("shoulder", "elbow")):
        columns |= {f"q_{name}": position[:, i], f"tau_{name}": sign * torque[:, i]}
    loaded = load_model(file)
    problem = make_problem(
        loaded, read_log(write_csv(tmp_path / "a.csv", columns), loaded)
    )
    assert isinstance(problem, TorqueLog)
    assert any("opposite sign to the model's" in n for n in problem.log.notes) == (
        sign < 0
    )
    left = problem.residuals([Hypothesis()])[0]
    assert np.sqrt(np.mean(left**2)) < 0.02 * np.sqrt(np.mean(torque**2))


def test_a_joint_whose_sensor_is_dead_can_be_left_out(tmp_path: Path) -> None:
    columns = {"time": TIME}
    for i, name in enumerate(("shoulder", "elbow", "wrist")):
        columns |= {name: POSITION[:, i], f"cmd_{name}": COMMAND[:, i]}
    columns["wrist"] = np.full(300, 0.5)
    # Its wrist is too light for its servo to be stepped explicitly.
    xml = ARM.replace("<worldbody>", '<option integrator="implicitfast"/><worldbody>')
    file, loaded = write_csv(tmp_path / "a.csv", columns), arm(tmp_path, xml)
    problem = make_problem(loaded, read_log(file, loaded, rename={"wrist": "-"}))
    assert problem.layout.channels == ("shoulder", "elbow")
    assert np.isfinite(problem.residuals([Hypothesis()])).all()


def test_a_part_of_a_recording_knows_the_commands_before_it(tmp_path: Path) -> None:
    late = 3  # frames

    def executed(episode: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        sent = commands(episode)
        return np.concatenate([sent[:1].repeat(late, 0), sent[:-late]])

    log = record(episodes=2, noise=0.0, motion=executed)
    sent = [replace(r, command=commands(i)) for i, r in enumerate(log.recordings)]
    (tmp_path / "arm.xml").write_text(TWO_LINKS)
    loaded = load_model(tmp_path / "arm.xml")
    problem = make_problem(loaded, replace(log, recordings=tuple(sent)))
    assert len(problem.log.recordings) == 6
    (note,) = problem.log.notes
    assert "The 2 recordings were cut into 6 parts" in note
    delay = AppliedEffect("command_delay", None, {"delay": late / FPS})
    left, known = problem.residuals([Hypothesis(), Hypothesis((delay,))])
    assert np.abs(left).max() > 0.05
    assert np.abs(known).max() < 1e-9


@pytest.mark.parametrize(
    ("count", "expected"),
    [
        (2, (2, 5)),  # every third part: each recording is in both
        (3, (4, 5)),  # the third recording, whole
        (5, (4, 5)),
        (6, (2, 5)),  # not cut
    ],
)
def test_recordings_are_held_out_whole_where_there_are_enough(
    count: int, expected: tuple[int, ...], tmp_path: Path
) -> None:
    (tmp_path / "arm.xml").write_text(TWO_LINKS)
    problem = make_problem(load_model(tmp_path / "arm.xml"), record(episodes=count))
    train, heldout = split(problem)
    assert heldout == expected
    assert sorted([*train, *heldout]) == list(range(len(problem.log.recordings)))


def test_a_recording_too_short_to_be_cut_is_held_out_like_the_others(
    tmp_path: Path,
) -> None:
    (tmp_path / "arm.xml").write_text(TWO_LINKS)
    log = record(episodes=3)
    brief = log.recordings[2].take(slice(0, round(1.5 * FPS)))
    log = replace(log, recordings=(*log.recordings[:2], brief))
    problem = make_problem(load_model(tmp_path / "arm.xml"), log)
    assert len(problem.log.recordings) == 5
    assert split(problem) == ((0, 1, 2, 3), (4,))
