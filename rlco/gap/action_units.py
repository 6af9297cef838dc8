"""Scales of a log's actions, how it writes the gripper, and actions as simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.action_readings import ActionReading, Motion
from rlco.gap.log import Array

#: What one of a log's numbers may be worth: [m], and [rad].
MOVES: Mapping[str, float] = {
    "parts of 5 cm": 0.05,
    "metres": 1.0,
    "centimetres": 0.01,
    "millimetres": 0.001,
}
TURNS: Mapping[str, float] = {
    "parts of 0.5 rad": 0.5,
    "radians": 1.0,
    "degrees": np.pi / 180.0,
}
# Real controllers answer softer or harder than simulated ones; units differ by more.
_NEAR = 1.6
_SHUT, _OPEN = 0.01, 0.06  # what counts as a closed and an open hand [m]
_MOVED = 0.005  # and as one that moved [m]


@dataclass(frozen=True)
class Scale:
    """What one of a log's numbers is worth.

    Attributes:
        name: One of `MOVES` or `TURNS`; empty for a size of its own.
        size: In metres or radians.
        measured: The same, as the motion tells it.
    """

    name: str
    size: float
    measured: float


@dataclass(frozen=True)
class Gripper:
    """How the gripper's number is written.

    Attributes:
        closes: ``high`` or ``low``: which end of its range closes.
        low: The lower end: -1 or 0.
        told: Whether the log shows it; else it is assumed.
    """

    closes: str = "high"
    low: float = -1.0
    told: bool = True

    def changes(self) -> list[str]:
        """Return what differs from the simulator, in words."""
        words = []
        if self.closes == "low":
            words.append("the gripper closes at the low end of its range")
        if self.low == 0.0:
            words.append("the gripper's number runs from 0 to 1, not from -1 to 1")
        return words

    def simulated(self, numbers: Array) -> Array:
        """Return the numbers with 1 for closing and -1 for opening."""
        middle = (self.low + 1.0) / 2.0
        side = (numbers - middle) / (1.0 - middle)
        return np.clip(side if self.closes == "high" else -side, -1.0, 1.0)


def nearest_scale(measured: float, known: Mapping[str, float]) -> Scale:
    """Return the unit that a measured size is nearest to, or a size of its own.

    Example:
        >>> nearest_scale(0.043, MOVES).name, nearest_scale(0.2, MOVES).name
        ('parts of 5 cm', '')
    """
    name = min(known, key=lambda n: abs(np.log(known[n] / max(measured, 1e-12))))
    ratio = known[name] / max(measured, 1e-12)
    if 1.0 / _NEAR < ratio < _NEAR:
        return Scale(name, known[name], measured)
    return Scale("", measured, measured)


def read_gripper(numbers: Sequence[Array], openings: Sequence[Array | None]) -> Gripper:
    """Find out how the gripper's number is written.

    Args:
        numbers: Of each recording, (T,).
        openings: Between the fingers, (T,), [m]; None where they are not told.

    Example:
        >>> wide = np.linspace(0.08, 0.0, 20)
        >>> read_gripper([np.full(20, -1.0)], [wide]).closes
        'low'
    """
    every = np.concatenate(list(numbers))
    low = 0.0 if every.min() > -0.05 and every.max() <= 1.05 and _spans(every) else -1.0
    middle = (low + 1.0) / 2.0
    closing = opening_ = 0.0
    for sides, wide in zip(numbers, openings, strict=True):
        if wide is None or len(wide) < 3:
            continue
        high = sides[:-1] > middle
        speed = np.diff(wide)
        moved = abs(wide.max() - wide.min()) > _MOVED
        if moved:
            # Which end narrows the hand, and which widens it?
            closing += -float(speed[high].sum()) + float(speed[~high].sum())
            opening_ += float(np.abs(speed).sum())
        elif wide.max() < _SHUT or wide.min() > _OPEN:
            shut = 1.0 if wide.max() < _SHUT else -1.0
            agree = shut * float(np.where(high, 1.0, -1.0).mean())
            closing, opening_ = closing + 1e-3 * agree, opening_ + 1e-3
    told = opening_ > 0.0 and abs(closing) > 0.3 * opening_
    return Gripper("low" if told and closing < 0.0 else "high", low, told)


def _spans(numbers: Array) -> bool:
    """Return whether numbers from 0 to 1 often show the lower end."""
    return bool((numbers < 0.25).mean() > 0.05)


def simulated_moves(
    motion: Motion, reading: ActionReading, scale: Scale, full: float
) -> Array:
    """Return the three numbers that ask the simulator for the same, (rows, 3).

    Args:
        motion: Of one recording; its rows are aligned, an action with its state.
        reading: How its actions are written.
        scale: What one of its numbers is worth.
        full: What one of the simulator's is worth, [m] or [rad].
    """
    if reading.kind == "delta":
        asked = scale.size * motion.asked @ reading.matrix.T
        if reading.frame == "tool":
            asked = np.einsum("tij,tj->ti", motion.turn, asked)
        return np.asarray(asked / full)
    target = motion.target @ reading.matrix.T
    if motion.angular:
        turns = Rotation.from_rotvec(target) * Rotation.from_rotvec(motion.place).inv()
        return np.asarray(turns.as_rotvec() / full)
    return np.asarray((target - motion.place) / full)
