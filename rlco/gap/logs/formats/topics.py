"""Headers that begin with a ROS topic, as PlotJuggler and its like write them.

``/joint_states/elbow/position``, ``/forward_position_controller/commands/data[0]`` and
``/joint_trajectory_controller/controller_state/reference/positions[0]``: the topic, and
the field of its message. Which topics there are is ros2_control's and ros_control's.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from rlco.gap.logs.table import Column, Kind

#: Fields of a message about joints.
_FIELDS: Mapping[str, Kind] = {
    "position": "position",
    "positions": "position",
    "q": "position",
    "velocity": "velocity",
    "velocities": "velocity",
    "dq": "velocity",
    "effort": "torque",
    "efforts": "torque",
    "tau_J": "torque",
    "q_d": "command",
    "dq_d": "extra",
    "ddq_d": "extra",
    "tau_J_d": "extra",
    "acceleration": "extra",
    "accelerations": "extra",
}
#: What a controller's state says of its joints: whether that was sent to them.
_PARTS: Mapping[str, bool | None] = {
    "output": True,
    "reference": True,
    "desired": True,
    "command": True,
    "feedback": False,
    "actual": False,
    "error": None,
}
_STATES = ("controller_state", "state")
_COMMANDS = ("commands", "command")
#: Of several that tell the same, the one nearest to the hardware.
_NEAREST = ("output", "commands", "command", "reference", "desired")
_INDEXED = re.compile(r"(?P<word>.*?)(?:\[(?P<index>\d+)\]|\.(?P<dotted>\d+))?")
_CONTROLLER = re.compile(r"_?(joint_)?(group_)?(position_)?controllers?$")


def parse_topic(header: str) -> Column | None:
    """Return what a header that begins with a topic says; None if it is no such one.

    Example:
        >>> column = parse_topic("/forward_position_controller/commands/data[2]")
        >>> column.kind, column.stem, column.source
        ('command', '2', '/forward_position_controller/commands')
        >>> column = parse_topic("/joint_states/elbow/effort")
        >>> column.kind, column.stem, column.source
        ('torque', 'elbow', '/joint_states')
    """
    parts = [part for part in header.split("/") if part]
    if len(parts) < 2:
        return None
    for parse in (_controller, _controller_state, _joint_states, _indexed_field):
        parsed = parse(parts)
        if parsed is not None:
            kind, stem, topic = parsed
            stem = header if kind == "extra" else stem
            return Column(kind, stem, header, source="/" + "/".join(topic))
    return None


def rank(source: str) -> int:
    """Return how near to the hardware a topic's commands are, 0 nearest.

    Example:
        >>> rank("/arm_controller/controller_state/reference") > rank("/arm/commands")
        True
    """
    last = source.rpartition("/")[2]
    return _NEAREST.index(last) if last in _NEAREST else len(_NEAREST)


_Told = tuple[Kind, str, list[str]] | None


def _controller(parts: list[str]) -> _Told:
    """Read ``/forward_position_controller/commands/data[0]``."""
    for at, part in enumerate(parts[1:-1], 1):
        word, index = _split(parts[at + 1])
        if part not in _COMMANDS or word != "data" or len(parts) != at + 2:
            continue
        controller = parts[at - 1]
        topic = parts[: at + 1]
        if any(other in controller for other in ("velocity", "effort", "torque")):
            return "extra", "", topic
        if index is None:  # one joint, after which its controller is named
            return "command", _CONTROLLER.sub("", controller), [part]
        return "command", index, topic
    return None


def _controller_state(parts: list[str]) -> _Told:
    """Read ``/joint_trajectory_controller/controller_state/reference/positions[0]``."""
    for at, part in enumerate(parts[1:-2], 1):
        if part not in _STATES or parts[at + 1] not in _PARTS:
            continue
        sent, topic = _PARTS[parts[at + 1]], parts[: at + 2]
        field = _field(parts[at + 2 :])
        if field is None or sent is None:
            return "extra", "", topic
        kind, stem = field
        if sent:
            kind = "command" if kind == "position" else "extra"
        return kind, stem, topic
    return None


def _joint_states(parts: list[str]) -> _Told:
    """Read ``/joint_states/elbow/position``, and ``/joint_commands/position[0]``."""
    for at, part in enumerate(parts[:-1]):
        words = part.lower().split("_")
        about = "joint" in words or "joints" in words
        if not about or words[-1] not in ("states", "state", "commands", "command"):
            continue
        field = _field(parts[at + 1 :])
        if field is None:
            return None
        kind, stem = field
        if words[-1].startswith("command"):
            kind = "command" if kind == "position" else "extra"
        return kind, stem, parts[: at + 1]
    return None


def _indexed_field(parts: list[str]) -> _Told:
    """Read ``/franka_states/q[0]``: a list in any message."""
    word, index = _split(parts[-1])
    if index is None or word not in _FIELDS or "[" in "".join(parts[:-1]):
        return None
    return _FIELDS[word], index, parts[:-1]


def _field(parts: list[str]) -> tuple[Kind, str] | None:
    """Return the quantity and the joint in what follows a topic, in either order."""
    words = [_split(part) for part in parts]
    for at in (len(words) - 1, 0):
        word, index = words[at]
        if word in _FIELDS:
            rest = [part for i, part in enumerate(parts) if i != at]
            return _FIELDS[word], "/".join(rest) or index or ""
    return None


def _split(part: str) -> tuple[str, str | None]:
    """Return a word and the number behind it: ``data[0]``."""
    found = _INDEXED.fullmatch(part)
    if found is None:
        return part, None
    return found["word"], found["index"] or found["dotted"]
