"""Degrees or radians: detected, converted and noted, or asked for.

A robot's log has all its angles in one unit. Which one it is shows in joints that
leave the model's range by far, in several joints that would turn more than a whole
revolution, and in speeds that no arm has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from rlco.errors import DataError, UnknownNameError
from rlco.gap.logs.angular_columns import Angular, angular_columns
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.logs.runaway import runaway

ANGLES = ("degrees", "radians")
_DEGREE = float(np.pi / 180.0)
# No arm's joint turns so far from zero: a revolution and a tenth [rad].
_LEAST_TURN = 2.2 * float(np.pi)
# A joint that is farther out of its range than this and a tenth of it cannot have that
# unit: zeros and limits are known better [rad].
_FAR = 0.35
_FAR_SHARE = 0.1
# No arm turns its joints faster [rad/s].
_TOO_FAST = 30.0
# Two signals are the same one with this cosine between them, or more ...
_ALIKE = 0.8
# ... and in degrees and radians where one is 57.3 times the other, to this factor.
_BETWEEN = (57.3 / 1.6, 57.3 * 1.6)


@dataclass(frozen=True)
class _Scales:
    """What to multiply each channel's angles by."""

    position: float
    velocity: float
    command: float


def to_radians(
    log: Log, model: mujoco.MjModel | None = None, angles: str | None = None
) -> Log:
    """Return the log with all angles in radians, and a note where that changed it.

    Positions and velocities of hinges and commands of position servos on hinges are
    angles; without a model all are taken for such. A recording in which a joint ran
    away, further than any unit explains, is left out, with a note.

    Args:
        log: In the units of its files.
        model: Its joints' ranges tell degrees from radians.
        angles: ``degrees`` or ``radians`` where it is known; None to detect it.

    Raises:
        UnknownNameError: `angles` is another word.
        DataError: The log shows that `angles` is wrong, or does not show the unit.

    Example:
        >>> position = np.linspace(0, 90, 50)[:, None] * np.ones(3)
        >>> recording = Recording("log", np.arange(50) * 0.1, position)
        >>> log = to_radians(Log((recording,), joints=("a", "b", "c")))
        >>> log.recordings[0].position[-1].round(4), log.notes
        (array([1.5708, 1.5708, 1.5708]),
         ('Angles are in degrees and were converted.',))
    """
    if angles not in (None, *ANGLES):
        raise UnknownNameError("unit of angles", str(angles), ANGLES)
    columns = angular_columns(log, model)
    log = _without_runaway(log, columns)
    recordings = [r for r in log.recordings if r.position is not None]
    if not recordings or not columns.joints.any():
        return log
    sent = _command_ratio(recordings, columns)
    unit = _decide(recordings, columns, angles)
    if unit == "radians" and sent < 1.0:
        raise DataError(
            "commands are 57 times smaller than positions, as if they were radians and "
            "positions degrees, but as degrees positions leave the model's range; give "
            "the model of this robot, or angles=degrees."
        )
    scale = _DEGREE if unit == "degrees" else 1.0
    scales = _Scales(scale, scale / _speed_ratio(recordings, columns), scale / sent)
    notes = _notes(scales)
    if not notes:
        return log
    changed = tuple(_scaled(r, columns, scales) for r in log.recordings)
    return replace(log, recordings=changed, notes=(*log.notes, *notes))


def _without_runaway(log: Log, columns: Angular) -> Log:
    arm = columns.joints & ~columns.turning
    if not arm.any() or any(r.position is None for r in log.recordings):
        return log
    reach = np.stack(
        [np.abs(np.asarray(r.position)).max(axis=0) for r in log.recordings]
    )
    far = runaway(reach[:, arm].max(axis=1))
    # In degrees, too, it is more than a turn.
    far &= reach[:, arm].max(axis=1) * _DEGREE > _LEAST_TURN
    if not far.any():
        return log
    notes = []
    for index in np.flatnonzero(far):
        joint = int(np.where(arm, reach[index], 0.0).argmax())
        notes.append(
            f"{log.recordings[index].name!r} is left out: {log.joints[joint]} reaches "
            f"{reach[index, joint]:.3g} in it, far beyond all other recordings."
        )
    kept = tuple(r for r, out in zip(log.recordings, far, strict=True) if not out)
    return replace(log, recordings=kept, notes=(*log.notes, *notes))


def _notes(scales: _Scales) -> list[str]:
    names = {
        "positions": scales.position,
        "velocities": scales.velocity,
        "commands": scales.command,
    }
    converted = [name for name, scale in names.items() if abs(scale - 1.0) > 1e-9]
    if len(converted) == 3:
        return ["Angles are in degrees and were converted."]
    return (
        [f"{' and '.join(converted)} are in degrees and were converted.".capitalize()]
        if converted
        else []
    )


def _command_ratio(recordings: Sequence[Recording], columns: Angular) -> float:
    """Return how many times the positions' unit goes into the commands': 1 or 57.3.

    Or 1 / 57.3, where commands are radians and positions degrees.
    """
    joints, actuators = [list(c) for c in zip(*columns.pairs, strict=True)] or [[], []]
    pairs = [
        (np.asarray(r.position)[:, joints], r.command[:, actuators])
        for r in recordings
        if r.command is not None
    ]
    if not pairs or not joints:
        return 1.0
    measured, sent = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return _unit_ratio(measured, sent)


def _speed_ratio(recordings: Sequence[Recording], columns: Angular) -> float:
    """Return the same of velocities."""
    pairs = [
        (
            np.gradient(np.asarray(r.position)[:, columns.joints], r.time, axis=0),
            r.velocity[:, columns.joints],
        )
        for r in recordings
        if r.velocity is not None and r.rows > 2
    ]
    if not pairs:
        return 1.0
    slopes, velocities = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return _unit_ratio(slopes, velocities)


def _unit_ratio(one: Array, other: Array) -> float:
    """Return 57.3 or 1 / 57.3 where two signals are one and that far apart, else 1."""
    sizes = [float(np.linalg.norm(part)) for part in (one, other)]
    if not all(sizes) or float((one * other).sum()) < _ALIKE * sizes[0] * sizes[1]:
        return 1.0
    ratio = sizes[1] / sizes[0]
    if _BETWEEN[0] < ratio < _BETWEEN[1]:
        return 1.0 / _DEGREE
    return _DEGREE if _BETWEEN[0] < 1.0 / ratio < _BETWEEN[1] else 1.0


def _decide(
    recordings: Sequence[Recording], columns: Angular, asked: str | None
) -> str:
    """Return the unit of the positions.

    Raises:
        DataError: It is not the one that was asked for, or it does not show.
    """
    position = np.concatenate([np.asarray(r.position) for r in recordings])
    position = position[:, columns.joints]
    low, high = columns.low[columns.joints], columns.high[columns.joints]
    beyond = [_outside(position * unit, low, high) for unit in (1.0, _DEGREE)]
    reach = float(np.abs(position).max())
    # A log of degrees in which no joint is at more than seven is hardly one.
    shown = reach > _LEAST_TURN and beyond[0] and not beyond[1]
    # A wheel may turn on and on; more than one joint of an arm does not.
    turns = ~columns.turning[columns.joints]
    turns &= np.abs(position).max(axis=0) > _LEAST_TURN
    fast = turns.any() and _top_speed(recordings, columns) > _TOO_FAST
    spun = not any(beyond) and (turns.sum() >= 2 or fast)
    if asked == "radians" and shown:
        raise DataError(
            f"angles reach {reach:.0f}, far outside the model's joint ranges as "
            "radians and inside them as degrees; give angles=degrees, or leave it out."
        )
    # Where the model's range has room for it, a joint may turn as far as commanded.
    if asked == "radians" and spun and not (high[turns] < np.inf).all():
        raise DataError(
            f"angles reach {reach:.0f}, further or faster than an arm's joints turn in "
            "radians; give angles=degrees, or leave it out, or give joints that do "
            "turn so a range in the model."
        )
    if asked == "degrees" and beyond[1] and not beyond[0]:
        raise DataError(
            f"angles reach no more than {reach:.2f}, outside the model's joint ranges "
            "as degrees and inside them as radians; give angles=radians, or leave it "
            "out."
        )
    if asked is not None:
        return asked
    if turns.any() and not any(beyond) and not spun:
        raise DataError(
            f"angles reach {reach:.1f} and may be degrees or radians; give "
            "angles=degrees or angles=radians."
        )
    return "degrees" if shown or spun else "radians"


def _outside(position: Array, low: Array, high: Array) -> bool:
    """Whether a joint is far outside its range in more than a hundredth of the rows."""
    slack = np.full(len(low), _FAR)
    limited = np.isfinite(low)
    slack[limited] += _FAR_SHARE * (high - low)[limited]
    beyond = (position < low - slack) | (position > high + slack)
    return bool((beyond.mean(axis=0) > 0.01).any())


def _top_speed(recordings: Sequence[Recording], columns: Angular) -> float:
    """Return the speed that a hundredth of the rows exceed, of the fastest joint."""
    steps = [
        np.abs(np.diff(np.asarray(r.position)[:, columns.joints], axis=0))
        / np.diff(r.time)[:, None]
        for r in recordings
    ]
    return float(np.percentile(np.concatenate(steps), 99, axis=0).max())


def _scaled(recording: Recording, columns: Angular, scales: _Scales) -> Recording:
    joints = np.where(columns.joints, scales.position, 1.0)
    speeds = np.where(columns.joints, scales.velocity, 1.0)
    commands = np.where(columns.commands, scales.command, 1.0)
    position, velocity, command = (
        recording.position,
        recording.velocity,
        recording.command,
    )
    return replace(
        recording,
        position=None if position is None else position * joints,
        velocity=None if velocity is None else velocity * speeds,
        command=None if command is None else command * commands,
    )
