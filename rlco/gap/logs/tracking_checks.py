"""Check that each joint follows its own command, before anything is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.errors import DataError
from rlco.files import few
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.model import LoadedModel
from rlco.physics.effects.targets import actuated_joint, command_at, is_servo

# Half of all rows further from their command than this, of half of all joints [rad].
_ASTRAY = 1.5
# Changes are taken over so long, and a joint may lag its command by so much [s].
_CHANGE = 0.2
_LAG = 0.3
_LAGS = 7
# A joint whose changes are like those of its command with this cosine moves against
# it, unless at another lag they are half as much like it: a fast joint that is late by
# half a period moves against its command, too.
_AGAINST = -0.5
_NO_LAG = 0.5
# A joint follows another's command with this cosine or more, by so much better.
_FOLLOWS = 0.8
_MARGIN = 0.4
# Two neighbouring readings of one encoder are no further apart [rad or m].
_STEP = 0.01
# No servo's dead zone is as wide [rad], [m].
_DEAD_ZONE = {mujoco.mjtJoint.mjJNT_HINGE: 0.1, mujoco.mjtJoint.mjJNT_SLIDE: 0.02}


@dataclass(frozen=True)
class _Servo:
    """A position servo: the columns of its joint and its command, and its gear.

    The gear is that of the command, see `command_at`.
    """

    joint: int
    command: int
    gear: float


def check_tracking(log: Log, model: LoadedModel) -> None:
    """Refuse a log whose joints do not follow the commands of their own servos.

    Args:
        log: In SI units, its times corrected.
        model: Whose position servos the commands are for.

    Raises:
        DataError: A joint's readings never change while its command does, a joint
            moves against its command, joints follow each other's commands, or most of
            them are far from their commands.
    """
    servos = _servos(log, model)
    parts = [
        (r.time, *_in_pairs(r, servos)) for r in log.recordings if r.command is not None
    ]
    if not servos or not parts:
        return
    names = [log.joints[servo.joint] for servo in servos]
    position, command = (np.concatenate([p[i] for p in parts]) for i in (1, 2))
    _refuse_dead(names, position, command, model)
    most, least = _likeness(parts)
    _refuse_swapped(names, most)
    _refuse_mirrored(names, most, least)
    _refuse_far(names, np.median(np.abs(command - position), axis=0))


def _servos(log: Log, model: LoadedModel) -> list[_Servo]:
    found = []
    for column, name in enumerate(log.actuators):
        if name not in model.actuators:
            continue
        number = model.actuators.index(name)
        joint = actuated_joint(model.model, number)
        gear = command_at(model.model, number)
        if is_servo(model.model, number) and joint in log.joints and gear:
            found.append(_Servo(log.joints.index(joint), column, gear))
    return found


def _in_pairs(recording: Recording, servos: Sequence[_Servo]) -> tuple[Array, Array]:
    """Return positions, and the commands as positions of joints, (T, servos) each."""
    sent, gears = np.asarray(recording.command), [servo.gear for servo in servos]
    return (
        np.asarray(recording.position)[:, [servo.joint for servo in servos]],
        sent[:, [servo.command for servo in servos]] / np.array(gears),
    )


def _refuse_dead(
    names: Sequence[str], position: Array, command: Array, model: LoadedModel
) -> None:
    for column, name in enumerate(names):
        levels = np.unique(position[:, column])
        # A joint that sticks still trembles in its readings, a loose cable does not.
        if len(levels) > 2 or np.ptp(levels) > _STEP:
            continue
        kind = mujoco.mjtJoint(model.model.joint(name).type[0])
        reach = float(np.ptp(command[:, column]))
        if reach > _DEAD_ZONE[kind]:
            unit = "rad" if kind == mujoco.mjtJoint.mjJNT_HINGE else "m"
            raise DataError(
                f"{name} is commanded over {reach:.2f} {unit} and its readings never "
                "move: a dead sensor or a wrong column; repair it, or leave the column "
                "of its positions out (rename=COLUMN:-)."
            )


def _likeness(parts: Sequence[tuple[Array, Array, Array]]) -> tuple[Array, Array]:
    """Return how much like a command's changes a joint's are, (joints, commands).

    Returns:
        The largest and the smallest cosine of all lags.
    """
    every = np.median(np.concatenate([np.diff(time) for time, _, _ in parts]))
    wide = max(1, round(_CHANGE / every))
    lags = sorted({round(lag / every) for lag in np.linspace(0.0, _LAG, _LAGS)})
    cosines = []
    for lag in lags:
        late = [np.asarray(p[lag + wide :] - p[lag:-wide]) for _, p, _ in parts]
        sent = [
            (c[wide:] - c[:-wide])[: len(m)]
            for (*_, c), m in zip(parts, late, strict=True)
        ]
        moved, asked = np.concatenate(late), np.concatenate(sent)
        sizes = np.outer(*(np.linalg.norm(side, axis=0) for side in (moved, asked)))
        product = moved.T @ asked
        cosines.append(np.divide(product, sizes, np.zeros_like(sizes), where=sizes > 0))
    return np.max(cosines, axis=0), np.min(cosines, axis=0)


def _refuse_swapped(names: Sequence[str], most: Array) -> None:
    best, own = most.argmax(axis=1), np.diag(most)
    apart = (most.max(axis=1) > own + _MARGIN) & (most.max(axis=1) > _FOLLOWS)
    others = {int(j): int(best[j]) for j in np.flatnonzero(apart)}
    if others and set(others.values()) == set(others):
        raise DataError(
            f"{few([names[j] for j in others])} look swapped: "
            f"{_swapped(names, others)}; give rename= for positions or for commands."
        )


def _swapped(names: Sequence[str], others: dict[int, int]) -> str:
    phrases = [
        f"the position of {names[j]} follows the command of {names[other]}"
        for j, other in others.items()
    ]
    return " and ".join(phrases[:2])


def _refuse_mirrored(names: Sequence[str], most: Array, least: Array) -> None:
    against = np.diag(least)
    wrong = (against < _AGAINST) & (np.diag(most) < -_NO_LAG * against)
    for column in np.flatnonzero(wrong)[:1]:
        raise DataError(
            f"the position of {names[column]} moves against its command: its sign "
            "differs; turn the sign of one of them in the log, or give the model of "
            "this robot."
        )


def _refuse_far(names: Sequence[str], apart: Array) -> None:
    if (apart > _ASTRAY).mean() > 0.5:
        worst = int(apart.argmax())
        raise DataError(
            f"commands and positions are far apart, {apart[worst]:.2f} at "
            f"{names[worst]} in half of all rows: they are of different joints, units "
            "or zeros; check the order of the columns, or give rename=."
        )
