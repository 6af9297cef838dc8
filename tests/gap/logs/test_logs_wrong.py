"""Wrong input: one sentence, with what is wrong and what to do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from log_cases import (
    ARM,
    JOINTS,
    arm,
    arm_columns,
    motion,
    write_arm,
    write_csv,
    write_lerobot,
)

from rlco.errors import DataError
from rlco.gap.logs import read_log

TIME, POSITION, COMMAND = motion()


def refused(
    tmp_path: Path, match: str, *, xml: str = ARM, **changes: np.ndarray
) -> str:
    """Return the sentence with which the motion with other columns is refused."""
    file = write_arm(tmp_path / "a.csv", **changes)
    with pytest.raises(DataError, match=match) as raised:
        read_log(file, arm(tmp_path, xml))
    assert "\n" not in str(raised.value)
    return str(raised.value)


def without(name: str, other: str) -> dict[str, np.ndarray]:
    columns = arm_columns(TIME, POSITION, COMMAND)
    return {other if key == name else key: value for key, value in columns.items()}


def test_a_name_that_matches_no_joint(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "a.csv", without("elbow", "elbo"))
    with pytest.raises(DataError) as raised:
        read_log(file, arm(tmp_path))
    assert "'elbo' (did you mean 'elbow'?)" in str(raised.value)
    assert "rename=" in str(raised.value)
    read_log(file, arm(tmp_path), rename={"elbo": "elbow"})


def test_no_name_that_matches(tmp_path: Path) -> None:
    columns = {"time": TIME, "position.a": POSITION[:, 0], "position.b": POSITION[:, 1]}
    file = write_csv(tmp_path / "a.csv", columns)
    with pytest.raises(DataError, match="model 'arm' matches the log's 2 columns a, b"):
        read_log(file, arm(tmp_path))


def test_no_position_of_a_data_set_matches_whatever_velocities_do(
    tmp_path: Path,
) -> None:
    parts = {
        "observation.state": (["a", "b", "c"], [POSITION]),
        "observation.velocity": (list(JOINTS), [POSITION]),
    }
    folder = write_lerobot(tmp_path / "set", parts)
    with pytest.raises(DataError, match="matches the log's 3 columns a, b, c"):
        read_log(folder, arm(tmp_path))


def test_actions_for_a_model_without_actuators(tmp_path: Path) -> None:
    start, end = ARM.index("<actuator>"), ARM.index("</mujoco>")
    xml = ARM[:start] + ARM[end:]
    told = refused(tmp_path, "model 'arm' has no actuators", xml=xml)
    assert "3 actions (shoulder, elbow, wrist)" in told
    assert "position servo" in told


def test_actions_that_do_not_match_the_actuators(tmp_path: Path) -> None:
    told = refused(tmp_path, "do not match", cmd_gripper=TIME)
    assert "4 actions (shoulder, elbow, wrist, gripper)" in told
    assert "3 actuators (m1, m2, m3)" in told
    xml = ARM.replace('<position name="m3" joint="wrist" kp="5" kv=".2"/>', "")
    command = {f"cmd_{name}": COMMAND[:, i] for i, name in enumerate(JOINTS)}
    told = refused(tmp_path, "do not match", xml=xml, **command)
    assert "3 actions (shoulder, elbow, wrist)" in told
    assert "2 actuators (m1, m2)" in told


def test_nan_tells_the_column_and_the_row(tmp_path: Path) -> None:
    elbow = POSITION[:, 1].copy()
    elbow[[41, 90]] = np.nan
    told = refused(tmp_path, "column 'elbow' of 'a'", elbow=elbow)
    assert "in 2 of 300 rows, first in row 42 at 0.820 s" in told


def test_a_number_that_nothing_measures_tells_the_column_and_the_row(
    tmp_path: Path,
) -> None:
    elbow, late = POSITION[:, 1].copy(), TIME.copy()
    elbow[41] = -1e308
    told = refused(tmp_path, "column 'elbow' of 'a'", elbow=elbow)
    assert "holds -1e+308 in row 42, which nothing measures" in told
    late[-1] = 1e308
    told = refused(tmp_path, "column 'time' of 'a'", time=late)
    assert "holds 1e+308 in row 300" in told


def test_nan_in_a_data_set_tells_the_number(tmp_path: Path) -> None:
    position = POSITION.copy()
    position[7, 2] = np.inf
    parts = {"observation.state": (list(JOINTS), [position])}
    with pytest.raises(DataError, match=r"'observation.state' \(wrist\).*frame 7"):
        read_log(write_lerobot(tmp_path / "set", parts), arm(tmp_path))


def test_gaps_in_a_column_that_nobody_needs_are_noted(tmp_path: Path) -> None:
    volts = np.where(TIME > 1, np.nan, TIME)
    log = read_log(write_arm(tmp_path / "a.csv", volts=volts), arm(tmp_path))
    assert log.notes == ("Column volts has gaps and is left out.",)
    assert log.recordings[0].extra == {}


def test_too_little_data(tmp_path: Path) -> None:
    columns = {k: v[:100] for k, v in arm_columns(TIME, POSITION).items()}
    file = write_csv(tmp_path / "a.csv", columns)
    with pytest.raises(DataError, match=r"holds 2\.0 s in 100 rows.*at least 4 s"):
        read_log(file, arm(tmp_path))


@pytest.mark.parametrize("limited", ["true", "false"])
def test_degrees_taken_for_radians(tmp_path: Path, limited: str) -> None:
    model = arm(tmp_path, ARM.replace('limited="true"', f'limited="{limited}"'))
    columns = arm_columns(TIME, np.degrees(POSITION), np.degrees(COMMAND))
    file = write_csv(tmp_path / "a.csv", columns)
    with pytest.raises(DataError, match="give angles=degrees"):
        read_log(file, model, angles="radians")
    log = read_log(file, model)
    np.testing.assert_allclose(log.recordings[0].position, POSITION, atol=1e-6)


def test_joints_that_the_model_lets_turn_further_are_no_degrees(
    tmp_path: Path,
) -> None:
    model = arm(tmp_path, ARM.replace('range="-2 2"', 'range="-99 99"'))
    wide = {"shoulder": 20 * POSITION[:, 0], "cmd_shoulder": 20 * COMMAND[:, 0]}
    file = write_arm(tmp_path / "a.csv", **wide)
    log = read_log(file, model, angles="radians")
    np.testing.assert_allclose(log.recordings[0].position[:, 0], wide["shoulder"])


def test_a_constant_joint_is_noted_and_all_of_them_refused(tmp_path: Path) -> None:
    noise = 1e-3 * np.random.default_rng(0).normal(size=(300, 3))
    one = write_arm(tmp_path / "a.csv", wrist=0.5 + noise[:, 0])
    log = read_log(one, arm(tmp_path))
    assert log.notes == ("Joints that never move are not informative: wrist.",)
    still = {name: 0.1 + noise[:, i] for i, name in enumerate(JOINTS)}
    refused(tmp_path, "no joint of the log moves", **still)


@pytest.mark.parametrize("step", [0.0, 0.0015])
def test_a_sensor_that_is_dead_while_its_joint_is_commanded(
    tmp_path: Path, step: float
) -> None:
    # Nothing, or an encoder between two of its readings.
    wrist = 0.5 + step * (np.arange(300) % 7 > 3)
    told = refused(tmp_path, "its readings never move", wrist=wrist)
    assert "wrist is commanded over 2.20 rad" in told
    file = write_arm(tmp_path / "a.csv", wrist=wrist)
    log = read_log(file, arm(tmp_path), rename={"wrist": "-"})
    assert log.joints == ("shoulder", "elbow")
    assert log.actuators == ("m1", "m2", "m3")
    # A joint that its command leaves at rest is no dead sensor.
    file = write_arm(tmp_path / "a.csv", wrist=wrist, cmd_wrist=0.5 + 0.01 * TIME)
    note = read_log(file, arm(tmp_path)).notes[0]
    assert note == "Joints that never move are not informative: wrist."


def test_another_models_log(tmp_path: Path) -> None:
    told = refused(tmp_path, "of another model", elbow=POSITION[:, 1] + 2.5)
    assert "positions of elbow lie between 0.6" in told
    assert "range in model 'arm' is -2.5 to 0.5" in told


def test_commands_of_other_joints(tmp_path: Path) -> None:
    sent = {f"cmd_{name}": COMMAND[:, i] + 3 for i, name in enumerate(JOINTS)}
    refused(tmp_path, "commands and positions are far apart, 3.0", **sent)


def test_swapped_joints(tmp_path: Path) -> None:
    swapped = {"shoulder": POSITION[:, 2], "wrist": POSITION[:, 0]}
    told = refused(tmp_path, "shoulder, wrist look swapped", **swapped)
    assert "the position of shoulder follows the command of wrist" in told
    file = write_arm(tmp_path / "a.csv", **swapped)
    names = {"shoulder": "position.wrist", "wrist": "position.shoulder"}
    names |= {f"cmd_{name}": f"command.{name}" for name in JOINTS}
    log = read_log(file, arm(tmp_path), rename=names)
    np.testing.assert_allclose(log.recordings[0].position, POSITION, atol=1e-6)


def test_a_mirrored_joint(tmp_path: Path) -> None:
    refused(
        tmp_path,
        "the position of wrist moves against its command: its sign differs",
        wrist=-POSITION[:, 2],
    )
    # The same of a servo whose gear turns it round is as it should be.
    xml = ARM.replace('joint="wrist"', 'joint="wrist" gear="-1"')
    file = write_arm(tmp_path / "a.csv", wrist=-POSITION[:, 2])
    read_log(file, arm(tmp_path, xml))


def test_a_fast_joint_that_is_late_by_half_a_period_is_not_mirrored(
    tmp_path: Path,
) -> None:
    late, fast = np.sin(12 * (TIME - 0.26)), np.sin(12 * TIME)
    file = write_arm(tmp_path / "a.csv", wrist=late, cmd_wrist=fast)
    assert np.corrcoef(late, fast)[0, 1] < -0.95
    assert read_log(file, arm(tmp_path)).notes == ()


def test_times_that_run_backwards(tmp_path: Path) -> None:
    time = TIME.copy()
    time[200:] -= 1.0
    refused(tmp_path, "timestamps of 'a' run backwards: .* in row 201", time=time)


def test_a_position_sensor_that_saturates(tmp_path: Path) -> None:
    shoulder = np.clip(POSITION[:, 0], None, 0.7)
    told = refused(tmp_path, "its sensor saturates", shoulder=shoulder)
    assert "the position of shoulder is cut off at 0.7" in told


def test_speeds_and_torques_that_saturate_are_noted(tmp_path: Path) -> None:
    torque = np.clip(3 * POSITION, -1.5, 1.5)
    columns = {f"tau_{name}": torque[:, i] for i, name in enumerate(JOINTS)}
    log = read_log(write_arm(tmp_path / "a.csv", **columns), arm(tmp_path))
    assert log.notes == (
        "The torque of shoulder is cut off at 1.5, where its sensor saturates.",
        "The torque of elbow is cut off at -1.5, where its sensor saturates.",
        "The torque of wrist is cut off at 1.5, where its sensor saturates.",
    )


def test_holding_still_at_an_extreme_is_no_saturation(tmp_path: Path) -> None:
    # Out, hold, back, on an encoder of 12 bits.
    quantum = 2 * np.pi / 4096
    phase = np.interp(TIME % 3, [0, 1, 2, 3], [0, 1, 1, 0])
    smooth = (
        np.round((10 * phase**3 - 15 * phase**4 + 6 * phase**5) / quantum) * quantum
    )
    log = read_log(write_arm(tmp_path / "a.csv", shoulder=smooth), arm(tmp_path))
    assert log.notes == ()


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("0,1,2\n1,2,3\n", "has no header; name its columns"),
        ("time,q1,q1\n0,1,2\n", "several columns named q1"),
        ("time,q1\n0,1\n1\n", "row 2 .* has 1 cell and the header 2"),
        ("time,q1\n0,1\n1,2\n2,abc\n", "'q1' .* holds 'abc' in row 3"),
        ("q1,q2\n0,1\n1,2\n", "has no column of times"),
        ("time,q1\n0,1\n20,2\n40,3\n", "rises by 20 per row.*'time_ms'"),
        ("time,q1\n", "holds no rows under a header"),
    ],
)
def test_csv_files_that_cannot_be_read(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DataError, match=match):
        read_log(tmp_path / "a.csv")


def test_a_quaternion_that_is_none(tmp_path: Path) -> None:
    columns = dict.fromkeys(("x", "y", "z", "qw", "qx", "qy", "qz"), TIME)
    file = write_csv(tmp_path / "a.csv", {"time": TIME, **columns})
    with pytest.raises(DataError, match=r"quaternion of 'a' has length 0.000 in row 1"):
        read_log(file)


def test_damaged_files(tmp_path: Path) -> None:
    for name, match in (
        ("a.npz", "is truncated or damaged .* save plain arrays with numpy"),
        ("a.db3", "rosbag2 of MCAP or SQLite .* damaged"),
        ("a.json", "is truncated or damaged"),
        ("a.txt", "has no known format"),
    ):
        (tmp_path / name).write_text("nonsense {")
        with pytest.raises(DataError, match=match):
            read_log(tmp_path / name)
    with pytest.raises(DataError, match="does not exist"):
        read_log(tmp_path / "nowhere")


def test_an_entry_that_lacks_a_number(tmp_path: Path) -> None:
    entries = [{"timestamp": 0.1 * i, "position": 0.1 * i} for i in range(9)]
    del entries[4]["position"]
    (tmp_path / "a.json").write_text(json.dumps({"entries": entries}))
    with pytest.raises(DataError, match=r"entry 5 of .* lacks 'position'"):
        read_log(tmp_path / "a.json")


def test_folders_without_one_kind_of_log(tmp_path: Path) -> None:
    model = arm(tmp_path)
    with pytest.raises(DataError, match=r"holds no log \(model.xml\)"):
        read_log(tmp_path, model)
    write_arm(tmp_path / "a.csv")
    np.savez(tmp_path / "a.npz", time=TIME)
    with pytest.raises(DataError, match=r"1 .csv, 1 .npz"):
        read_log(tmp_path, model)


@pytest.mark.parametrize("rows", [1, 2])
def test_recordings_without_motion_are_left_out(tmp_path: Path, rows: int) -> None:
    columns = arm_columns(TIME, POSITION, COMMAND)
    (logs := tmp_path / "logs").mkdir()
    write_csv(logs / "a.csv", columns)
    write_csv(logs / "b.csv", {k: v[:rows] for k, v in columns.items()})
    log = read_log(logs, arm(tmp_path))
    assert [one.name for one in log.recordings] == ["a"]
    assert any(n.startswith(f"'b' is left out: it has {rows} row") for n in log.notes)
    with pytest.raises(DataError, match="'b' is left out"):
        read_log(logs / "b.csv", arm(tmp_path))


@pytest.mark.parametrize(
    ("count", "told"),
    [(12, []), (13, ["One more note like these."]), (14, ["2 more notes like these."])],
)
def test_notes_that_are_not_listed_are_counted(
    tmp_path: Path, count: int, told: list[str]
) -> None:
    columns = arm_columns(TIME, POSITION, COMMAND)
    (logs := tmp_path / "logs").mkdir()
    write_csv(logs / "a.csv", columns)
    for number in range(count):
        brief = {name: values[:1] for name, values in columns.items()}
        write_csv(logs / f"b{number}.csv", brief)
    notes = read_log(logs, arm(tmp_path)).notes
    assert [note for note in notes if note.endswith("like these.")] == told
