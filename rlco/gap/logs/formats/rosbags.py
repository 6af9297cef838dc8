"""rosbag2 recordings, MCAP or SQLite, read without ROS.

Joint states are measured; joint states of a topic with a word for commands in its name,
what ros2_control's forward controllers are sent, and what its joint trajectory
controllers ask of the hardware are commands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import apsw
import numpy as np
from backports import zstd
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from rlco.errors import DataError
from rlco.files import few, reading
from rlco.files.reading import check_kind
from rlco.gap.logs.formats import bag_databases, bag_sizes
from rlco.gap.logs.formats.headers import WORDS
from rlco.gap.logs.formats.topics import parse_topic
from rlco.gap.logs.log import Array
from rlco.gap.logs.table import Column, Kind, Table

_STATES = "sensor_msgs/msg/JointState"
_ARRAY = "std_msgs/msg/Float64MultiArray"
_CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
#: Fields of a joint state, and of a controller's state what it sends to the joints.
_FIELDS: Mapping[str, Kind] = {
    "position": "position",
    "velocity": "velocity",
    "effort": "torque",
}
_SENT = ("output", "reference", "desired")
# Stamps and receipts further apart are of two clocks [s].
_OTHER_CLOCK = 1.0
# What rosbags and the readers below it raise that is no built-in exception.
_OWN = (ReaderError, SerdeError, TypesysError, apsw.Error, zstd.ZstdError)


#: A list in a message: its field, whose each number is, the numbers.
_Part = tuple[str, tuple[str, ...], Array]


@dataclass
class _Topic:
    """The messages of one topic.

    Attributes:
        kind: The type of its messages.
        stamps: When each was measured; by its receipt, where it bears no stamp [ns].
        receipts: When each was recorded [ns].
        rows: The lists of each message, by their fields.
    """

    kind: str
    stamps: list[int] = field(default_factory=list)
    receipts: list[int] = field(default_factory=list)
    rows: list[dict[str, _Part]] = field(default_factory=list)


def read_rosbag(path: Path) -> list[Table]:
    """Read a ``.db3`` or ``.mcap`` file, or the folder of a bag.

    Rows are the joint states; commands are held from message to message.

    Raises:
        DataError: It is no such bag, or holds no joint states.
    """
    topics = _topics(path)
    states = [name for name, topic in topics.items() if topic.kind == _STATES]
    measured = [name for name in states if not _is_command(name)] or states
    chosen = "/joint_states" if "/joint_states" in measured else measured[0]
    origin = topics[chosen].stamps[0]
    time = _seconds(topics[chosen].stamps, origin)
    columns = _columns(path, chosen, topics[chosen])
    left = []
    for name, topic in topics.items():
        if name == chosen:
            continue
        sent = [c for c in _columns(path, name, topic) if c[0].kind == "command"]
        if not sent:
            left.append(name)
            continue
        apart = _clocks_apart(topics[chosen], topic)
        sent_at = _seconds(topic.stamps, origin + apart)
        # What held at each time; the first before any was sent.
        rows = np.searchsorted(sent_at, time, side="right") - 1
        columns += [(column, values[np.clip(rows, 0, None)]) for column, values in sent]
    notes = [f"Topics left out: {few(left)}."] if left else []
    name = path.stem if path.is_file() else path.name
    return [Table(name, time, tuple(columns), {}, tuple(notes))]


def _seconds(stamps: Sequence[int], origin: int) -> Array:
    return np.array([stamp - origin for stamp in stamps]) * 1e-9


def _clocks_apart(states: _Topic, other: _Topic) -> int:
    """Return how far a topic's clock is ahead of the joint states' [ns].

    Messages without a stamp are known by their receipt, which may be by another clock
    than the stamps of simulated or replayed time.
    """
    if other.stamps != other.receipts:
        return 0
    late = np.array(states.receipts) - np.array(states.stamps)
    apart = int(np.median(late))
    return apart if abs(apart) > _OTHER_CLOCK * 1e9 else 0


def _is_command(topic: str) -> bool:
    words = topic.lower().replace("/", "_").split("_")
    return any(word in WORDS["command"] for word in words if len(word) > 2)


def _topics(path: Path) -> dict[str, _Topic]:
    """Return the topics of joints with their messages.

    Raises:
        DataError: The bag cannot be read, or has no joint states.
    """
    advice = "give a whole bag, 'ros2 bag reindex' may repair one that was cut off"
    what = "rosbag2 of MCAP or SQLite"
    bag_sizes.bound_chunks()
    bag_databases.check_databases()
    if path.is_dir():
        check_kind(*path.iterdir(), advice="take it away")
        with reading(path, *_OWN, what=what, advice=advice):
            bag_sizes.check_files(path)
    with reading(path, *_OWN, what=what, advice=advice), Reader(path) as bag:
        # Of messages that are compressed rosbags does not ask how large they are.
        compressed = bag.compression_mode == "message"
        if compressed:
            metadata = bag.storage.metadata
            bag.storage.metadata = metadata._replace(compression_mode=None)
        wanted = [c for c in bag.connections if c.msgtype in _READERS]
        listed = [f"{c.topic} ({c.msgtype})" for c in bag.connections]
        store, known = _typestore(wanted)
        found: dict[str, _Topic] = {}
        held, most = 0, bag_sizes.most_of(path)
        for connection, receipt, data in bag.messages(known) if known else ():
            if compressed:
                data = bag_sizes.message(data)
            held += len(data)
            if held > most:
                raise DataError(
                    f"{str(path)!r} holds more than {most / 1e6:.0f} MB of messages, "
                    f"{bag_sizes.RATIO} times its size; give one that is what it says."
                )
            topic = found.setdefault(connection.topic, _Topic(connection.msgtype))
            _add(path, connection.topic, topic, store, receipt, data)
    if not any(topic.kind == _STATES for topic in found.values()):
        raise DataError(
            f"{str(path)!r} holds no messages of {_STATES}; it has "
            f"{few(listed) or 'none'}."
        )
    return found


def _typestore(wanted: Sequence[Connection]) -> tuple[Typestore, list[Connection]]:
    """Return how messages are decoded, and the connections of which that is known.

    A bag of MCAP has the definitions of its messages in it, one of SQLite from ROS 2
    Iron on; ROS's own messages are known anyway.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    for one in wanted:
        definition = one.msgdef
        if one.msgtype in store.fielddefs:
            continue
        if definition.format == MessageDefinitionFormat.MSG:
            types = get_types_from_msg(definition.data, one.msgtype)
        elif definition.format == MessageDefinitionFormat.IDL:
            types = get_types_from_idl(definition.data)
        else:
            continue
        store.register({k: v for k, v in types.items() if k not in store.fielddefs})
    return store, [one for one in wanted if one.msgtype in store.fielddefs]


def _add(
    path: Path, name: str, topic: _Topic, store: Typestore, receipt: int, data: bytes
) -> None:
    """Decode a message and add it to its topic."""
    what = f"message {len(topic.rows) + 1} of {name} in"
    with reading(path, *_OWN, what=what, advice="record it again"):
        message: Any = store.deserialize_cdr(data, topic.kind)
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    stamped = 0 if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec
    topic.receipts.append(receipt)
    topic.stamps.append(stamped or receipt)
    parts = _READERS[topic.kind](message)
    topic.rows.append({part[0]: part for part in parts if len(part[1]) == len(part[2])})


def _joint_state(message: Any) -> list[_Part]:
    names = tuple(message.name)
    return [(one, names, getattr(message, one)) for one in _FIELDS]


def _array(message: Any) -> list[_Part]:
    return [("data", tuple(map(str, range(len(message.data)))), message.data)]


def _controller_state(message: Any) -> list[_Part]:
    names = tuple(message.joint_names)
    parts = [(one, getattr(message, one, None)) for one in _SENT]
    return [(one, names, point.positions) for one, point in parts if point is not None]


_READERS = {_STATES: _joint_state, _ARRAY: _array, _CONTROLLER: _controller_state}


def _columns(path: Path, name: str, topic: _Topic) -> list[tuple[Column, Array]]:
    """Return the columns of a topic, of fields that are filled in all its messages.

    Raises:
        DataError: Messages name different joints.
    """
    columns = []
    for part, names, _ in topic.rows[0].values():
        if not all(part in row for row in topic.rows):
            continue
        rows = []
        for row in topic.rows:
            _, here, values = row[part]
            if here != names:
                if set(here) != set(names):
                    raise DataError(
                        f"messages of {name} in {str(path)!r} name different joints; "
                        "record one robot a topic."
                    )
                values = values[[here.index(joint) for joint in names]]
            rows.append(values)
        stacked = np.array(rows, dtype=float)
        parsed = [_column(topic.kind, name, part, joint) for joint in names]
        columns += [(c, stacked[:, i]) for i, c in enumerate(parsed) if c is not None]
    return columns


def _column(kind: str, topic: str, part: str, joint: str) -> Column | None:
    """Return what a number in a message is; None where nothing says."""
    if kind == _ARRAY:
        return parse_topic(f"{topic}/data[{joint}]")
    if kind == _CONTROLLER:
        source = f"{topic}/{part}"
        return Column("command", joint, f"{source}/positions/{joint}", source=source)
    header, quantity = f"{topic}/{joint}/{part}", _FIELDS[part]
    if _is_command(topic):
        quantity = "command" if quantity == "position" else "extra"
    stem = header if quantity == "extra" else joint
    return Column(quantity, stem, header, source=topic)
