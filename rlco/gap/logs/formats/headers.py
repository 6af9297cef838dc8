"""What a column's header says: ``q1``, ``tau_elbow``, ``command.joint2``, ``x``.

A header is a quantity and a name, in either order and joined by ``.``, ``_``, ``/``,
``:``, ``-``, a blank or nothing before a number; or a joint's name alone, which is its
position. Units may follow in brackets: ``elbow [deg]``. What begins with a ROS topic is
read by `rlco.gap.logs.formats.topics`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import replace

from rlco.errors import DataError
from rlco.files import shown
from rlco.gap.logs.formats.topics import parse_topic
from rlco.gap.logs.table import Angles, Column, Kind

#: Words for each quantity; upper and lower case are the same.
WORDS: dict[Kind, tuple[str, ...]] = {
    "position": (
        *("position", "positions", "pos", "q", "qpos", "angle", "angles", "state"),
        *("joint_position", "joint_positions", "joint_pos", "dof_pos", "joint_angle"),
        *("joint_angles", "servo_angle", "servo_angles", "present_position"),
        *("observation.state", "measured_position", "q_measured", "q_meas"),
        *("actual_q", "actual_position", "actual_positions", "actual_joint_positions"),
        *("actual_joint_position", "actual_pos", "measured_q", "feedback_position"),
        *("feedback_positions", "current_position", "current_q"),
    ),
    "velocity": (
        *("velocity", "velocities", "vel", "dq", "qd", "qvel", "speed"),
        *("joint_velocity", "joint_velocities", "joint_vel", "joint_speed"),
        *("joint_speeds", "realtime_joint_speeds", "dof_vel", "present_velocity"),
        *("observation.velocity", "measured_velocity", "actual_qd", "actual_velocity"),
        *("actual_velocities", "actual_joint_velocities", "feedback_velocity"),
    ),
    "torque": (
        *("torque", "torques", "tau", "effort", "efforts", "joint_torque"),
        *("joint_torques", "joints_torque", "joint_effort", "joint_efforts"),
        *("measured_torque", "actual_torque", "actual_torques", "actual_effort"),
        *("feedback_effort", "tau_measured", "observation.effort"),
        "observation.torque",
    ),
    "command": (
        *("command", "commands", "cmd", "action", "actions", "ctrl", "control", "u"),
        *("target", "goal", "setpoint", "reference", "ref", "desired", "des"),
        *("q_des", "q_desired", "q_cmd", "q_ref", "q_target", "q_goal"),
        *("des_dof_pos", "target_q", "desired_q", "goal_position", "goal_pos"),
        *("target_position", "target_positions", "target_pos", "target_angle"),
        *("target_angles", "position_command", "position_cmd", "pos_cmd"),
        *("command_position", "joint_command", "joint_commands", "cmd_pos"),
        *("target_joint_position", "target_joint_positions", "desired_position"),
        *("desired_positions", "reference_position", "reference_positions", "des_pos"),
        *("pos_des", "pos_target", "last_used_angles"),
    ),
    # A command of a speed or a torque says nothing of where a servo is sent, and a
    # current is no torque.
    "extra": (
        *("dq_d", "dq_des", "qd_des", "dq_cmd", "target_qd", "target_velocity"),
        *("goal_velocity", "desired_velocity", "velocity_command", "velocity_cmd"),
        *("vel_cmd", "ddq_d", "target_qdd", "tau_des", "tau_cmd", "tau_d"),
        *("tau_j_d", "tau_ext", "tau_ext_hat_filtered", "tau_external"),
        *("target_torque", "target_moment", "torque_command", "desired_torque"),
        *("current", "currents", "actual_current", "target_current", "present_current"),
        *("goal_current", "motor_current", "joint_current", "measured_current"),
    ),
}
TIME = ("time", "t", "timestamp", "timestamps", "stamp", "seconds", "secs", "elapsed")
#: Seconds in one unit of a time whose header ends so: ``time_ms``.
TIME_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TURN = 2.0 * math.pi
#: What positions and speeds are multiplied by, to be in radians or metres, whose header
#: gives another unit of these. Degrees are a matter of the whole log.
UNITS = {
    **dict.fromkeys(("mrad", "mrad/s", "mm", "mm/s"), 1e-3),
    **dict.fromkeys(("cm", "cm/s"), 1e-2),
    **dict.fromkeys(("rev", "turn", "turns", "rev/s", "turns/s", "rps"), _TURN),
    **dict.fromkeys(("rpm", "rev/min", "turns/min", "1/min"), _TURN / 60.0),
}
#: A free body's place and quaternion, in the order of `Recording.pose`.
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
#: Headers of numbers that say to which recording a row belongs.
EPISODE = ("episode", "episode_index", "trajectory", "trial", "run", "recording")

#: Characters of a header.
_LONGEST = 300

_JOIN = r"[\s._/:\-]+"
_UNIT = re.compile(r"\s*[\[(]\s*([^\d\[\]()][^\[\]()]*)[\])]\s*$")
_KINDS: dict[str, Kind] = {word: kind for kind, all_ in WORDS.items() for word in all_}
_WORD = "|".join(
    re.escape(word).replace("_", r"[\s._\-]?").replace(r"\.", r"[._/]")
    for word in sorted(_KINDS, key=len, reverse=True)
)
_BEFORE = re.compile(rf"(?P<word>{_WORD}){_JOIN}(?P<stem>.+)", re.IGNORECASE)
_AFTER = re.compile(rf"(?P<stem>.+?){_JOIN}(?P<word>{_WORD})", re.IGNORECASE)
_COUNTED = re.compile(
    rf"(?P<word>{_WORD})[\s._\-\[(]*(?P<stem>\d*)[\])]?", re.IGNORECASE
)
# Franka's names. Of torques behind the gears: ``tau_j1`` is one of a joint ``j1``. Of
# desired positions: ``qd_1`` is a speed.
_LINK_TORQUE = re.compile(r"(?P<word>tau)_J(?:[._]|\[)(?P<stem>\d+)\]?")
_DESIRED = re.compile(r"q_d(?:(?:[._]|\[)(?P<stem>[^\]]+)\]?)?")
_POSE = re.compile(
    rf"(?:(?P<stem>.+?){_JOIN})??(?:(?:position|pos|p)(?:{_JOIN})?)?"
    rf"(?P<axis>[xyz]|(?:q|quat|orientation)(?:{_JOIN})?[wxyz])",
    re.IGNORECASE,
)


def parse_header(
    header: str,
    joints: Collection[str] = (),
    actuators: Collection[str] = (),
    default: Kind = "extra",
) -> Column:
    """Return the meaning of a column, from its header.

    Args:
        header: The column's name in the file.
        joints: Names of the model's joints: a header that is one is its position.
        actuators: Names of actuators: a header that is one, and no joint, is its
            command.
        default: The kind of a header without a quantity in it.

    Example:
        >>> columns = [parse_header(h) for h in ("dq2", "cmd_elbow", "wrist.pos")]
        >>> [(column.kind, column.stem) for column in columns]
        [('velocity', '2'), ('command', 'elbow'), ('position', 'wrist')]
    """
    _check_length(header)
    plain, angles = _without_unit(header)
    parsed = parse_topic(plain)
    if parsed is not None and plain not in joints and plain not in actuators:
        return replace(parsed, header=header, angles=angles)
    plain = plain.removeprefix("field.")  # before each name, as `rostopic echo -p` has
    if plain in joints or plain in actuators:
        bare: Kind = "position" if plain in joints else "command"
        return Column(bare if default == "extra" else default, plain, header, angles)
    desired = _DESIRED.fullmatch(plain)
    if desired is not None:
        return Column("command", desired["stem"] or "", header, angles)
    for pattern in (_LINK_TORQUE, _COUNTED, _BEFORE, _AFTER):
        found = pattern.fullmatch(plain)
        if found is not None:
            kind = _KINDS[_word(found["word"])]
            stem = plain if kind == "extra" else found["stem"]
            return Column(kind, stem, header, angles)
    # What is an angle and no speed is a position.
    bare = "position" if angles and default == "extra" else default
    return Column(bare, plain, header, angles)


def parse_time(header: str) -> float | None:
    """Return the seconds in one unit of a column of times; None if it is none.

    Example:
        >>> parse_time("timestamp_ns"), parse_time("Time [ms]"), parse_time("tau")
        (1e-09, 0.001, None)
    """
    _check_length(header)
    if header.strip() == "%time":  # as `rostopic echo -p` writes it
        return TIME_UNITS["ns"]
    words = re.findall(r"[a-z]+", header.lower())
    if not words or words[0] not in TIME:
        return None
    if len(words) == 1:
        return 1.0
    return TIME_UNITS.get(words[1]) if len(words) == 2 else None


def parse_pose(header: str) -> tuple[str, str] | None:
    """Return the body and the axis of a column of a pose; None if it is none.

    Example:
        >>> parse_pose("cube.qw"), parse_pose("pos_x"), parse_pose("elbow")
        (('cube', 'qw'), ('', 'x'), None)
    """
    _check_length(header)
    found = _POSE.fullmatch(_without_unit(header)[0])
    if found is None:
        return None
    axis = found["axis"].lower()
    turns = "q" if len(axis) > 1 else ""
    return found["stem"] or "", turns + axis[-1]


def unit_factor(header: str) -> float:
    """Return what a column is multiplied by, to be in radians or metres.

    Example:
        >>> unit_factor("elbow [mrad]"), unit_factor("elbow [deg]"), unit_factor("x")
        (0.001, 1.0, 1.0)
    """
    found = _UNIT.search(header)
    return 1.0 if found is None else UNITS.get(found[1].strip().lower(), 1.0)


def _check_length(header: str) -> None:
    # Patterns take a time that grows with the square of a header's length.
    if len(header) > _LONGEST:
        raise DataError(
            f"the log has a column whose name has {len(header)} characters, "
            f"{shown(header[:40])} and so on, and at most {_LONGEST} are read; rename "
            "it or leave it out."
        )


def _without_unit(header: str) -> tuple[str, Angles | None]:
    found = _UNIT.search(header)
    if found is None:
        return header.strip(), None
    unit = found[1].strip().lower()
    degrees, radians = unit.startswith(("deg", "°")), unit.startswith(("rad", "mrad"))
    plain = header[: found.start()].strip()
    return plain, "degrees" if degrees else "radians" if radians else None


def _word(written: str) -> str:
    """Return a word of `WORDS` as it stands there."""
    key = re.sub(r"[\s._/\-]", "", written.lower())
    return _BARE[key]


_BARE = {re.sub(r"[\s._/\-]", "", word): word for word in _KINDS}
