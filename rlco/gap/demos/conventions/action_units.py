"""Scales of a log's actions, its gripper convention, and their conversion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.demos.conventions.actions import ActionConvention, Motion
from rlco.gap.logs.log import Array

#: Known sizes of one unit of a log's actions: [m], and [rad].
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
# Real controllers respond more softly or stiffly than simulated ones; units differ
# more.
_NEAR = 1.6
_SHUT, _OPEN = 0.01, 0.06  # openings of a closed and of an open gripper [m]
_MOVED = 0.005  # change of the opening that counts as motion [m]


@dataclass(frozen=True)
class Scale:
    """The size of one unit of a log's action.

    Attributes:
        name: One of `MOVES` or `TURNS`; empty if it matches none.
        size: In metres or radians.
        measured: The same, as estimated from the motion.
    """

    name: str
    size: float
    measured: float

    @property
    def is_measured(self) -> bool:
        """Whether the motion has about this size."""
        return 1.0 / _NEAR < self.size / max(self.measured, 1e-12) < _NEAR


@dataclass(frozen=True)
class Gripper:
    """The convention of the gripper command.

    Attributes:
        closes: ``high`` or ``low``: which end of its range closes.
        low: The lower end: -1 or 0.
        observed: Whether the log reveals it; otherwise it is assumed.
    """

    closes: str = "high"
    low: float = -1.0
    observed: bool = True

    def changes(self) -> list[str]:
        """Return differences from the simulator, one phrase each."""
        phrases = []
        if self.closes == "low":
            phrases.append("the gripper closes at the low end of its range")
        if self.low == 0.0:
            phrases.append("the gripper's command runs from 0 to 1, not from -1 to 1")
        return phrases

    def simulated(self, numbers: Array) -> Array:
        """Return the commands with 1 for closing and -1 for opening."""
        middle = (self.low + 1.0) / 2.0
        side = (numbers - middle) / (1.0 - middle)
        return np.clip(side if self.closes == "high" else -side, -1.0, 1.0)


def known_scale(name: str, known: Mapping[str, float]) -> Scale:
    """Return a known unit as a scale."""
    return Scale(name, known[name], known[name])


def nearest_scale(measured: float, known: Mapping[str, float]) -> Scale:
    """Return the known unit nearest to a measured size, or a scale without a name.

    Example:
        >>> nearest_scale(0.043, MOVES).name, nearest_scale(0.2, MOVES).name
        ('parts of 5 cm', '')
    """
    name = min(known, key=lambda n: abs(np.log(known[n] / max(measured, 1e-12))))
    scale = Scale(name, known[name], measured)
    return scale if scale.is_measured else Scale("", measured, measured)


def read_gripper(numbers: Sequence[Array], openings: Sequence[Array | None]) -> Gripper:
    """Infer the convention of the gripper command.

    Args:
        numbers: Commands of each recording, (T,).
        openings: Distance between the fingers, (T,), [m]; None where it was not logged.

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
            # Find the end of the range that closes the gripper.
            closing += -float(speed[high].sum()) + float(speed[~high].sum())
            opening_ += float(np.abs(speed).sum())
        elif wide.max() < _SHUT or wide.min() > _OPEN:
            shut = 1.0 if wide.max() < _SHUT else -1.0
            agree = shut * float(np.where(high, 1.0, -1.0).mean())
            closing, opening_ = closing + 1e-3 * agree, opening_ + 1e-3
    observed = opening_ > 0.0 and abs(closing) > 0.3 * opening_
    return Gripper("low" if observed and closing < 0.0 else "high", low, observed)


def _spans(numbers: Array) -> bool:
    """Return whether commands from 0 to 1 are often near the lower end."""
    return bool((numbers < 0.25).mean() > 0.05)


def simulated_moves(
    motion: Motion, convention: ActionConvention, scale: Scale, full: float
) -> Array:
    """Return the equivalent commands of the simulator, (rows, 3).

    Args:
        motion: Of one recording; each row aligns an action with its state.
        convention: Of its actions.
        scale: Size of one unit of its actions.
        full: Size of one unit of the simulator's actions, [m] or [rad].
    """
    if convention.kind == "delta":
        commanded = scale.size * motion.commanded @ convention.matrix.T
        if convention.frame == "tool":
            commanded = np.einsum("tij,tj->ti", motion.turn, commanded)
        return np.asarray(commanded / full)
    target = motion.target @ convention.matrix.T
    if motion.angular:
        turns = (
            Rotation.from_rotvec(target) * Rotation.from_rotvec(motion.position).inv()
        )
        return np.asarray(turns.as_rotvec() / full)
    return np.asarray((target - motion.position) / full)
