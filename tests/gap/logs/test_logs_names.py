"""What headers mean, and which name is which joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from log_cases import ARM, JOINTS, arm, motion, write_arm, write_csv

from rlco.errors import DataError
from rlco.gap.logs import read_log
from rlco.gap.logs.formats.headers import parse_header, parse_pose, parse_time
from rlco.gap.logs.names import match_names


@pytest.mark.parametrize(
    ("header", "kind", "stem"),
    [
        ("q1", "position", "1"),
        ("DQ_3", "velocity", "3"),
        ("tau[0]", "torque", "0"),
        ("effort.elbow_joint", "torque", "elbow_joint"),
        ("command.left_arm-j1", "command", "left_arm-j1"),
        ("shoulder_pan.pos", "position", "shoulder_pan"),
        ("elbow_target_position", "command", "elbow"),
        ("q_des_2", "command", "2"),
        ("goal_position", "command", ""),
        ("observation.state.hip", "position", "hip"),
        ("hip [deg]", "position", "hip"),
        # A speed or a torque that was asked for is no command of a position.
        ("dq_des_1", "extra", "dq_des_1"),
        ("volts", "extra", "volts"),
        # Words inside other words are none.
        ("quality", "extra", "quality"),
        ("posture", "extra", "posture"),
    ],
)
def test_headers(header: str, kind: str, stem: str) -> None:
    column = parse_header(header)
    assert (column.kind, column.stem, column.header) == (kind, stem, header)


def test_names_of_the_model_come_before_words() -> None:
    assert parse_header("q1", joints=["q1"]).stem == "q1"
    assert parse_header("target_joint", joints=["target_joint"]).kind == "position"
    assert parse_header("motor", actuators=["motor"]).kind == "command"


def test_units_of_angles_and_times() -> None:
    assert parse_header("q1 (deg)").angles == "degrees"
    assert parse_header("q1[rad]").angles == "radians"
    assert [parse_time(h) for h in ("time", "t_ms", "Time [us]", "stamp.ns")] == [
        1.0,
        1e-3,
        1e-6,
        1e-9,
    ]
    assert [parse_time(h) for h in ("tau", "time_left", "q1")] == [None] * 3


def test_poses() -> None:
    seven = ["cube.x", "cube_pos_y", "pz", "q_w", "orientation.x", "quat_y", "qz"]
    assert [parse_pose(h)[1] for h in seven] == ["x", "y", "z", "qw", "qx", "qy", "qz"]
    assert parse_pose("cube.qx")[0] == "cube"
    assert [parse_pose(h) for h in ("q1", "elbow", "max")] == [None] * 3


@pytest.mark.parametrize(
    ("given", "known", "found"),
    [
        (["b", "a"], ["a", "b"], {"b": "b", "a": "a"}),
        (["Left Knee"], ["left_knee", "hip"], {"Left Knee": "left_knee"}),
        (["ur_a", "ur_b"], ["a", "b", "c"], {"ur_a": "a", "ur_b": "b"}),
        (["a", "b"], ["a_joint", "b_joint"], {"a": "a_joint", "b": "b_joint"}),
        (
            ["joint1"],
            ["robot0_joint1", "gripper0_right_finger"],
            {"joint1": "robot0_joint1"},
        ),
        (["2", "1"], ["hip", "knee"], {"1": "hip", "2": "knee"}),
        (["0", "1"], ["hip", "knee"], {"0": "hip", "1": "knee"}),
        ([""], ["hip"], {"": "hip"}),
        # As many numbers as joints, but they do not count them.
        (["1", "7"], ["hip", "knee"], {}),
        (["1", "2", "3"], ["hip", "knee"], {}),
        (["hip", "toe"], ["hip", "knee"], {"hip": "hip"}),
        ([], ["hip"], {}),
    ],
)
def test_matches(given: list[str], known: list[str], found: dict[str, str]) -> None:
    assert match_names(given, known) == found


def test_rename_gives_columns_their_joint_quantity_or_end(tmp_path: Path) -> None:
    time, position, command = motion()
    columns = {"time": time, "a": position[:, 0], "b_deg": position[:, 1]}
    columns |= {"q_wrist": position[:, 2], "a_cmd": command[:, 0]}
    columns |= {"sent2": command[:, 1], "cmd_wrist": command[:, 2]}
    columns |= {"cmd_gripper": time}
    file = write_csv(tmp_path / "a.csv", columns)
    rename = {
        "a": "shoulder",
        "b_deg": "elbow",
        "sent2": "command.elbow",
        "cmd_gripper": "-",
    }
    log = read_log(file, arm(tmp_path), rename=rename)
    assert log.joints == JOINTS
    part = log.recordings[0]
    np.testing.assert_allclose(part.position, position, atol=1e-6)
    np.testing.assert_allclose(part.command, command, atol=1e-6)
    assert part.extra == {}


def test_currents_are_torques_once_they_are_multiplied(tmp_path: Path) -> None:
    time, position, _ = motion()
    current = np.cos(time[:, None] * [1.0, 2.0, 3.0])
    columns = {"time": time}
    for i in range(3):
        columns |= {f"actual_q_{i}": position[:, i]}
        columns |= {f"actual_current_{i}": current[:, i]}
    file = write_csv(tmp_path / "a.csv", columns)
    factors = [12.5, 12.5, 9.1]
    log = read_log(
        file,
        arm(tmp_path),
        scale={f"actual_current_{i}": factors[i] for i in range(3)},
        rename={"actual_current_0": "tau_0"},  # and its siblings
    )
    (part,) = log.recordings
    np.testing.assert_allclose(part.torque, current * factors, atol=1e-5)


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        ({"shoulderr": 2.0}, r"column 'shoulderr' .did you mean 'shoulder'"),
        ({"shoulder": 0.0}, "the factor 0.0; give a number other than 0"),
        ({"shoulder": float("nan")}, "the factor nan"),
    ],
)
def test_factors_that_cannot_be_are_refused(
    scale: dict[str, float], message: str, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=message):
        read_log(write_arm(tmp_path / "a.csv"), arm(tmp_path), scale=scale)


def test_rename_of_what_is_not_there_is_refused(tmp_path: Path) -> None:
    file = write_arm(tmp_path / "a.csv")
    with pytest.raises(DataError, match=r"'sholdr' .did you mean 'shoulder'"):
        read_log(file, arm(tmp_path), rename={"sholdr": "wrist"})


def test_without_a_model_joints_have_their_own_names(tmp_path: Path) -> None:
    time, position, command = motion()
    columns = {"time": time, "q1": position[:, 0], "q2": position[:, 1]}
    columns |= {"cmd_1": command[:, 0], "q_hip": position[:, 2]}
    log = read_log(write_csv(tmp_path / "a.csv", columns))
    assert log.joints == ("q1", "q2", "hip")
    assert log.actuators == ("q1",)


def unnamed(tmp_path: Path, names: dict[str, list[str]]) -> Path:
    """Write the motion under headers that say nothing by themselves."""
    time, position, command = motion()
    columns = {"time": time}
    columns |= dict(zip(names["position"], position.T, strict=True))
    columns |= dict(zip(names["command"], command.T, strict=True))
    return write_csv(tmp_path / "a.csv", columns)


@pytest.mark.parametrize(
    ("rename", "position", "command"),
    [
        # One column speaks for those that differ from it in their number ...
        ({"enc0": "q_0", "out0": "cmd_0"}, "enc{i}", "out{i}"),
        ({"enc3": "q_1", "out0": "cmd_0"}, "enc{n}", "out{i}"),
        # ... or in the name of their joint,
        (
            {"enc_elbow": "position.elbow", "elbow_out": "command.elbow"},
            "enc_{joint}",
            "{joint}_out",
        ),
        # a word for all columns that begin with it.
        ({"enc": "position", "out": "command"}, "enc[{i}]", "out_{i}"),
    ],
)
def test_one_rename_of_a_family_renames_its_siblings(
    tmp_path: Path, rename: dict[str, str], position: str, command: str
) -> None:
    told = [{"i": i, "n": i + 3, "joint": joint} for i, joint in enumerate(JOINTS)]
    names = {"position": [position.format(**one) for one in told]}
    names["command"] = [command.format(**one) for one in told]
    log = read_log(unnamed(tmp_path, names), arm(tmp_path), rename=rename)
    part = log.recordings[0]
    np.testing.assert_allclose(part.position, motion()[1], atol=1e-6)
    np.testing.assert_allclose(part.command, motion()[2], atol=1e-6)


def test_leaving_out_a_column_leaves_its_siblings_and_a_topic_all_of_its_own(
    tmp_path: Path,
) -> None:
    topic = "/arm_controller/commands"
    states = [f"/joint_states/{name}/position" for name in JOINTS]
    sent = [f"{topic}/data[{i}]" for i in range(3)]
    file = unnamed(tmp_path, {"position": states, "command": sent})
    model = arm(tmp_path)
    log = read_log(file, model, rename={topic: "-"})
    assert log.recordings[0].command is None
    assert log.joints == JOINTS
    log = read_log(file, model, rename={states[2]: "-"})
    assert log.joints == JOINTS[:2]
    assert log.recordings[0].command is not None


def test_two_joints_that_are_swapped_by_rename_leave_the_third(tmp_path: Path) -> None:
    xml = ARM.replace("shoulder", "j1").replace("elbow", "j2").replace("wrist", "j3")
    names = {"position": ["j2", "j1", "j3"], "command": ["m1", "m2", "m3"]}
    file = unnamed(tmp_path, names)
    log = read_log(file, arm(tmp_path, xml), rename={"j1": "j2", "j2": "j1"})
    np.testing.assert_allclose(log.recordings[0].position, motion()[1], atol=1e-6)


def test_of_two_columns_that_tell_the_same_one_is_used_and_that_is_said(
    tmp_path: Path,
) -> None:
    time, position, command = motion()
    columns = {"time": time}
    for i in range(3):
        columns |= {f"q{i}": position[:, i], f"cmd_{i}": command[:, i]}
        columns |= {f"angle{i}": position[:, i] + 0.01}
    log = read_log(write_csv(tmp_path / "a.csv", columns), arm(tmp_path))
    found = np.asarray(log.recordings[0].position) - position
    np.testing.assert_allclose(found, 0.01, atol=1e-6)
    assert "Positions are those of angle*; left out: q*." in log.notes
    assert log.unused == ("q0", "q1", "q2")
