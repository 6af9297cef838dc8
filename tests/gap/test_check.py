"""Effects that were found are compared with recordings that nothing was fitted to."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hidden_arms import TWO_LINKS, commands, record
from recipe_cases import start

from rlco.errors import RlcoError
from rlco.gap import check_effects
from rlco.gap.logs.log import Log
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import EffectError
from rlco.physics.effects.effects_file import write_effects

DAMPING = AppliedEffect("viscous_damping", "elbow", {"damping": 0.5})


@pytest.fixture
def robot(tmp_path: Path) -> tuple[Path, Path]:
    """Return a model and one recording of the robot, whose elbow is damped more."""

    def damp(model: object) -> None:
        model.dof_damping[1] += 0.5  # type: ignore[attr-defined]

    (tmp_path / "arm.xml").write_text(TWO_LINKS)
    return tmp_path / "arm.xml", _written(
        record(damp, episodes=1, motion=lambda seed: commands(seed, 6.0)),
        tmp_path / "a.csv",
    )


def _written(log: Log, path: Path) -> Path:
    (one,) = log.recordings
    assert one.position is not None
    assert one.command is not None
    names = [*log.joints, *(f"cmd_{name}" for name in log.actuators)]
    rows = np.column_stack([one.time, one.position, one.command])
    header = ",".join(["time", *names])
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return path


def test_the_true_effect_leaves_the_noise(
    robot: tuple[Path, Path], tmp_path: Path
) -> None:
    write_effects(tmp_path / "effects.yaml", [DAMPING])
    check = check_effects(*robot, tmp_path / "effects.yaml")
    assert check.channels == ("shoulder", "elbow")
    np.testing.assert_allclose(check.after, 4e-4, rtol=0.15)  # as `record` adds
    assert check.before[1] > 10 * check.after[1]
    assert not any("cut into" in note for note in check.notes)


def test_the_recipe_writes_what_it_says(
    robot: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_effects(tmp_path / "effects.yaml", [DAMPING])
    given = [f"model={robot[0]}", f"data={robot[1]}"]
    given += [f"check={tmp_path / 'effects.yaml'}", f"out={tmp_path / 'check'}"]
    start("find_gap", *given)
    shown = capsys.readouterr().err
    found = json.loads((tmp_path / "check" / "check.json").read_text())
    assert found["channels"] == ["shoulder", "elbow"]
    assert found["after"][1] < 0.1 * found["before"][1]
    assert "elbow   : " in shown
    assert "mrad with the effects; noise" in shown


def test_effects_of_another_robot_are_refused(
    robot: tuple[Path, Path], tmp_path: Path
) -> None:
    wrist = AppliedEffect("viscous_damping", "wrist", {"damping": 0.5})
    write_effects(tmp_path / "effects.yaml", [wrist])
    with pytest.raises(RlcoError, match=r"unknown target .*'wrist'; known: shoulder, "):
        check_effects(*robot, tmp_path / "effects.yaml")


@pytest.mark.parametrize(
    ("name", "target", "numbers", "said"),
    [
        ("command_delay", None, {"delay": -1.0}, "delay=-1 s cannot be so small"),
        ("command_delay", None, {"delay": 1e9}, r"delay=1e\+09 s is beyond 60 s"),
        ("coulomb_friction", "elbow", {"frictionloss": -5.0}, "less than none"),
        ("armature", "elbow", {"armature": -1e6}, "less than none"),
        ("viscous_damping", "elbow", {"damping": -1e300}, "is beyond"),
        ("joint_offset", "elbow", {"offset": 1e300}, "is beyond 300000 rad"),
        ("encoder_scale", "elbow", {"factor": 0.0}, "give a number above 0"),
        ("scene_mass", None, {"factor": 0.0}, "only rlco's own tasks read it"),
    ],
)
def test_what_no_robot_has_is_refused_before_the_log_is_read(
    robot: tuple[Path, Path],
    tmp_path: Path,
    name: str,
    target: str | None,
    numbers: dict[str, float],
    said: str,
) -> None:
    write_effects(tmp_path / "effects.yaml", [AppliedEffect(name, target, numbers)])
    with pytest.raises(EffectError, match=said):
        check_effects(robot[0], "no log", tmp_path / "effects.yaml")


def test_a_comparison_that_the_log_does_not_allow_is_refused(
    robot: tuple[Path, Path], tmp_path: Path
) -> None:
    write_effects(tmp_path / "effects.yaml", [DAMPING])
    with pytest.raises(RlcoError, match="compare=torques needs"):
        check_effects(*robot, tmp_path / "effects.yaml", compare="torques")


def test_what_diverges_is_said_and_no_number_of_json(
    robot: tuple[Path, Path], tmp_path: Path
) -> None:
    wild = AppliedEffect("actuator_gain", "elbow", {"factor": 1e6})
    write_effects(tmp_path / "effects.yaml", [wild])
    check = check_effects(*robot, tmp_path / "effects.yaml")
    content = json.loads(json.dumps(check.as_json(), allow_nan=False))
    assert content["after"] == [None, None]
    assert content["before"][1] == pytest.approx(check.before[1])
    assert ", diverging with the effects; noise 0.4" in check.lines()[0]
