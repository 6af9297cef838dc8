"""rosbag2 recordings as ROS writes them: MCAP and SQLite, whole folders and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_cases import JOINTS, arm, motion
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rlco.errors import DataError
from rlco.gap.logs import read_log

TIME, POSITION, COMMAND = motion()
STORES = {"mcap": StoragePlugin.MCAP, "db3": StoragePlugin.SQLITE3}
STATE, ARRAY = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
# The fields of ros2_controllers' message that matter here, with what they refer to.
CONTROLLER_TEXT = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint output
"""
TYPES = get_typestore(Stores.ROS2_HUMBLE)
TYPES.register(get_types_from_msg(CONTROLLER_TEXT, CONTROLLER))
Messages = Sequence[tuple[float, Any]]  # when each was received [s]


def header(stamp: float) -> Any:
    """Return a header; stamp 0 for none."""
    seconds = int(stamp)
    rest = round((stamp - seconds) * 1e9)
    time = TYPES.types["builtin_interfaces/msg/Time"](seconds, rest)
    return TYPES.types["std_msgs/msg/Header"](time, "base")


def state(stamp: float, names: Sequence[str], position: Sequence[float]) -> Any:
    none = np.zeros(0)
    return TYPES.types[STATE](
        header(stamp), list(names), np.array(position), none, none
    )


def array(values: Sequence[float]) -> Any:
    layout = TYPES.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    return TYPES.types[ARRAY](layout, np.array(values))


def controller(stamp: float, sent: Sequence[float], asked: Sequence[float]) -> Any:
    none = np.zeros(0)
    duration = TYPES.types["builtin_interfaces/msg/Duration"](0, 0)
    point = TYPES.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    points = [point(np.array(p), none, none, none, duration) for p in (asked, [], sent)]
    return TYPES.types[CONTROLLER](header(stamp), list(JOINTS), *points)


def write_bag(
    folder: Path, topics: Mapping[str, tuple[str, Messages]], store: str = "mcap"
) -> Path:
    """Write a bag; messages in the order in which they were received."""
    with Writer(folder, version=9, storage_plugin=STORES[store]) as bag:
        rows = []
        for topic, (kind, messages) in topics.items():
            connection = bag.add_connection(topic, kind, typestore=TYPES)
            rows += [(stamp, connection, kind, message) for stamp, message in messages]
        for stamp, connection, kind, message in sorted(rows, key=lambda row: row[0]):
            data = TYPES.serialize_cdr(message, kind)
            bag.write(connection, round(1e9 * stamp), data)
    return folder


def states(start: float = 100.0) -> tuple[str, Messages]:
    """The motion as joint states, joints in changing order."""
    rows = []
    for row, time in enumerate(TIME.tolist()):
        order = [0, 1, 2] if row % 2 else [2, 0, 1]
        names = [JOINTS[i] for i in order]
        told = state(start + time, names, POSITION[row][order])
        rows.append((start + time + 2e-4, told))
    return STATE, rows


@pytest.mark.parametrize("store", ["mcap", "db3"])
@pytest.mark.parametrize("whole", [True, False], ids=["folder", "file"])
def test_joint_states_and_what_a_forward_controller_was_sent(
    tmp_path: Path, store: str, whole: bool
) -> None:
    # A command comes a millisecond before the state is measured, without a stamp.
    sent = [(99.999 + t, array(c)) for t, c in zip(TIME, COMMAND, strict=True)]
    topics = {
        "/joint_states": states(),
        "/forward_position_controller/commands": (ARRAY, sent),
    }
    bag = write_bag(tmp_path / "run", topics, store)
    path = bag if whole else next(bag.glob(f"*.{store}"))
    log = read_log(path, arm(tmp_path))
    part = log.recordings[0]
    assert (log.joints, log.actuators) == (JOINTS, ("m1", "m2", "m3"))
    np.testing.assert_allclose(part.time, TIME, atol=1e-9)
    np.testing.assert_allclose(part.position, POSITION)
    np.testing.assert_allclose(part.command, COMMAND)
    assert part.velocity is None


def test_joint_states_that_are_commands(tmp_path: Path) -> None:
    sent = [
        (99.999 + t, state(99.999 + t, JOINTS, c))
        for t, c in zip(TIME, COMMAND, strict=True)
    ]
    topics = {"/joint_states": states(), "/arm/joint_commands": (STATE, sent)}
    log = read_log(write_bag(tmp_path / "run", topics), arm(tmp_path))
    np.testing.assert_allclose(log.recordings[0].command, COMMAND)


def test_a_trajectory_controllers_output_is_nearer_than_its_reference(
    tmp_path: Path,
) -> None:
    rows = [
        (99.999 + t, controller(99.999 + t, c, c + 0.5))
        for t, c in zip(TIME, COMMAND, strict=True)
    ]
    topic = "/joint_trajectory_controller/controller_state"
    topics = {"/joint_states": states(), topic: (CONTROLLER, rows)}
    log = read_log(write_bag(tmp_path / "run", topics), arm(tmp_path))
    np.testing.assert_allclose(log.recordings[0].command, COMMAND)
    assert any(f"{topic}/output; left out: {topic}/ref" in note for note in log.notes)


def test_stamps_of_simulated_time_meet_receipts_of_the_computers(
    tmp_path: Path,
) -> None:
    received = 1.7e9
    measured = [
        (received + t, state(100.0 + t, JOINTS, p))
        for t, p in zip(TIME, POSITION, strict=True)
    ]
    # Half of the commands: each is held for two rows.
    sent = [
        (received - 1e-3 + t, array(c))
        for t, c in zip(TIME[::2], COMMAND[::2], strict=True)
    ]
    topics = {
        "/joint_states": (STATE, measured),
        "/arm_controller/commands": (ARRAY, sent),
    }
    part = read_log(write_bag(tmp_path / "run", topics), arm(tmp_path)).recordings[0]
    np.testing.assert_allclose(part.command, np.repeat(COMMAND[::2], 2, axis=0))


def test_a_folder_of_bags_is_that_many_recordings(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_bag(tmp_path / "bags" / name, {"/joint_states": states()})
    log = read_log(tmp_path / "bags", arm(tmp_path))
    assert [part.name for part in log.recordings] == ["one", "two"]


def test_a_bag_without_joint_states_says_what_it_has(tmp_path: Path) -> None:
    sent = [(100.0 + t, array(c)) for t, c in zip(TIME, COMMAND, strict=True)]
    bag = write_bag(tmp_path / "run", {"/arm_controller/commands": (ARRAY, sent)})
    with pytest.raises(DataError, match=r"no messages of sensor_msgs.*/arm_controller"):
        read_log(bag, arm(tmp_path))


@pytest.mark.parametrize("name", ["a.mcap", "a.db3"])
@pytest.mark.parametrize("content", [b"", b"no bag at all" * 100])
def test_what_is_no_bag_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        DataError, match=r"rosbag2 of MCAP or SQLite .* (damaged|cannot be read)"
    ):
        read_log(tmp_path / name, arm(tmp_path))


def test_a_bag_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "run", {"/joint_states": states()})
    file = next(bag.glob("*.mcap"))
    (tmp_path / "cut.mcap").write_bytes(file.read_bytes()[: 2**13])
    with pytest.raises(
        DataError, match=r"rosbag2 of MCAP or SQLite .* (damaged|cannot be read)"
    ):
        read_log(tmp_path / "cut.mcap", arm(tmp_path))
