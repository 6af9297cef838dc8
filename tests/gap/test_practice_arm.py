"""A simulated arm's logs agree with its known model, but for what is hidden."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from rlco.errors import OutputExistsError, RlcoError
from rlco.gap import load_model, make_problem, practice_arm, read_log
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.practice_arm import TORQUE_NOISE, record_arm, write_known_model
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.spec.domain import SIM, Domain

HELD = AppliedEffect("payload", "right_hand", {"mass": 0.5, "x": 0, "y": 0, "z": 0.1})


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("known") / "arm.xml"
    write_known_model(path, "push_cube")
    return path


def errors(model: Path, logs: Path) -> np.ndarray:
    """Return the RMS disagreement of each part of the recordings [N m]."""
    loaded = load_model(model)
    problem = make_problem(loaded, read_log(logs, loaded))
    recordings = problem.layout.recording
    (rows,) = problem.residuals([Hypothesis()], range(recordings.max() + 1))
    return np.sqrt(np.bincount(recordings, rows**2) / np.bincount(recordings))


@pytest.mark.thorough
def test_every_recording_of_the_known_arm_agrees_with_its_model(
    model: Path, tmp_path: Path
) -> None:
    # Of the motions that are tried, some hit the table, and some shake.
    record_arm(tmp_path / "logs", "push_cube", "sim", recordings=5)
    found = errors(model, tmp_path / "logs")
    assert len(list((tmp_path / "logs").glob("*.npz"))) == 5
    # Accelerations out of positions have noise, too; a touch would be ten times it.
    assert found.max() < 3.0 * TORQUE_NOISE


@pytest.mark.slow
def test_a_hidden_payload_is_in_the_logs_and_not_in_the_model(
    model: Path, tmp_path: Path
) -> None:
    robot = Domain("robot", (HELD,), SIM.sensors)
    record_arm(tmp_path / "logs", "push_cube", robot, recordings=2, seconds=5.0)
    # Half a kilogram at half a metre from the elbow is some 2.5 N m there.
    assert errors(model, tmp_path / "logs").min() > 10.0 * TORQUE_NOISE


def test_a_payload_may_weigh_twice_the_robot_and_not_its_table(model: Path) -> None:
    compiled = load_model(model).model
    mass, *_ = EFFECTS["payload"].parameters(compiled, "robot0_right_hand")
    robot = [
        float(compiled.body_mass[i])
        for i in range(compiled.nbody)
        if mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_BODY, i).startswith(
            ("robot0_link", "robot0_right_hand", "gripper0")
        )
    ]
    # The first link stands still.
    still = float(compiled.body("robot0_link0").mass[0])
    assert mass.high == pytest.approx(2.0 * (sum(robot) - still))
    assert mass.high < 60.0 < compiled.body_mass.sum()


def test_a_folder_is_not_overwritten(tmp_path: Path) -> None:
    with pytest.raises(OutputExistsError):
        record_arm(tmp_path, "push_cube", "sim")


def test_motions_that_touch_something_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(practice_arm, "_touches", lambda model, data: True)
    with pytest.raises(RlcoError, match=r"in only 0 of 6 motions of 0.1 s"):
        record_arm(tmp_path / "logs", "push_cube", "sim", recordings=2, seconds=0.1)
    assert not (tmp_path / "logs").exists()
