"""rosbag2 recordings (SQLite) of joint states, read without ROS.

The messages are decoded from CDR, the encoding of DDS (OMG, DDS-XTypes 1.3, 7.4).
"""

from __future__ import annotations

import sqlite3
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rlco.errors import DataError
from rlco.gap.log import Array
from rlco.gap.logs.headers import WORDS
from rlco.gap.logs.matching import few
from rlco.gap.logs.table import Column, Kind, Table

_TYPE = "sensor_msgs/msg/JointState"
_FIELDS: tuple[Kind, ...] = ("position", "velocity", "torque")


@dataclass(frozen=True)
class _JointState:
    """One message: its stamp [ns], and NaN-free lists that may be empty."""

    stamp: int
    names: tuple[str, ...]
    values: tuple[Array, Array, Array]


def read_rosbag(path: Path) -> list[Table]:
    """Read one ``.db3`` file: joint states, and commands where a topic has them.

    Of several topics of joint states those with a word for commands in their name
    (``/joint_commands``) are commands, held from message to message.

    Raises:
        DataError: It is no such file, or holds no joint states.
    """
    topics = _topics(path)
    told = {name: _is_command(name) for name in topics}
    measured = [name for name, command in told.items() if not command] or list(topics)
    chosen = "/joint_states" if "/joint_states" in measured else measured[0]
    states = _series(path, chosen, topics[chosen])
    columns = [
        (Column(kind, joint, f"{chosen} {kind} {joint}"), values)
        for (kind, joint), values in states.channels.items()
    ]
    sent = [name for name in topics if told[name] and name != chosen]
    for name in sent[:1]:
        commands = _series(path, name, topics[name])
        columns += _held(name, commands, states.time)
    left = [name for name in topics if name not in (chosen, *sent[:1])]
    notes = [f"Topics left out: {few(left)}."] if left else []
    time = states.time - states.time[0]
    return [Table(path.stem, time, tuple(columns), {}, tuple(notes))]


@dataclass(frozen=True)
class _Series:
    time: Array
    channels: dict[tuple[Kind, str], Array]


def _is_command(topic: str) -> bool:
    words = topic.lower().replace("/", "_").split("_")
    return any(word in WORDS["command"] for word in words if len(word) > 2)


def _topics(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return the messages of each topic of joint states, with their times [ns]."""
    try:
        # Another connection's lock or journal must not be made: it may be read-only.
        uri = f"{path.resolve().as_uri()}?mode=ro&immutable=1"
        with sqlite3.connect(uri, uri=True) as bag:
            listed = bag.execute("SELECT id, name, type FROM topics").fetchall()
            found = {
                name: bag.execute(
                    "SELECT timestamp, data FROM messages WHERE topic_id = ? "
                    "ORDER BY timestamp, id",
                    (number,),
                ).fetchall()
                for number, name, kind in listed
                if kind == _TYPE
            }
    except sqlite3.Error as error:
        raise DataError(
            f"file {str(path)!r} cannot be read as a rosbag2 of SQLite ({error}); "
            "convert other storage with 'ros2 bag convert'."
        ) from None
    found = {name: messages for name, messages in found.items() if messages}
    if not found:
        others = [f"{name} ({kind})" for _, name, kind in listed]
        raise DataError(
            f"file {str(path)!r} holds no messages of {_TYPE}; it has "
            f"{few(others) or 'none'}."
        )
    return found


def _series(path: Path, topic: str, messages: list[tuple[int, bytes]]) -> _Series:
    decoded = []
    for number, (stamp, data) in enumerate(messages):
        try:
            decoded.append(_decode(data, stamp))
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            raise DataError(
                f"message {number + 1} of {topic} in {str(path)!r} is no joint state "
                f"({error}); record it again."
            ) from None
    names = decoded[0].names
    if not names or any(set(message.names) != set(names) for message in decoded):
        raise DataError(
            f"messages of {topic} in {str(path)!r} name different joints; record one "
            "robot a topic."
        )
    orders = [[message.names.index(name) for name in names] for message in decoded]
    channels: dict[tuple[Kind, str], Array] = {}
    for field, kind in enumerate(_FIELDS):
        # A field may be empty, in all messages or in none.
        if all(len(message.values[field]) == len(names) for message in decoded):
            rows = [m.values[field][o] for m, o in zip(decoded, orders, strict=True)]
            stacked = np.stack(rows)
            channels |= {(kind, name): stacked[:, i] for i, name in enumerate(names)}
    first = decoded[0].stamp
    time = np.array([(message.stamp - first) * 1e-9 for message in decoded])
    return _Series(time + first * 1e-9, channels)


def _held(topic: str, sent: _Series, time: Array) -> list[tuple[Column, Array]]:
    """Return the commands that held at each time; the first before any was sent."""
    rows = np.clip(np.searchsorted(sent.time, time, side="right") - 1, 0, None)
    return [
        (Column("command", joint, f"{topic} {joint}"), values[rows])
        for (kind, joint), values in sent.channels.items()
        if kind == "position"
    ]


def _decode(data: bytes, received: int) -> _JointState:
    """Decode one message; without a stamp of its own, its time is its receipt's."""
    order = "<" if data[1] & 1 else ">"
    body, at = data[4:], 0

    def number(form: str, size: int) -> int:
        nonlocal at
        at += -at % size
        value = struct.unpack_from(order + form, body, at)[0]
        at += size
        return int(value)

    def text() -> str:
        nonlocal at
        length = number("I", 4)
        word = body[at : at + length].split(b"\0", 1)[0].decode()
        at += length
        return word

    def doubles() -> Array:
        nonlocal at
        count = number("I", 4)
        at += -at % 8 if count else 0
        values = np.frombuffer(body, f"{order}f8", count, at).astype(float)
        at += 8 * count
        return values

    stamp = number("i", 4) * 1_000_000_000 + number("I", 4)
    text()
    names = tuple(text() for _ in range(number("I", 4)))
    values = (doubles(), doubles(), doubles())
    return _JointState(stamp or received, names, values)
