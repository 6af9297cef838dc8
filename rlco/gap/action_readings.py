"""How a log writes its actions, tried out against how the tool then moved.

In a control step the tool moves by ``m[t] = k m[t-1] + b r[t]``, where r is what the
action asks for under a reading: a controller's answer in two numbers. A reading is as
good as the part of the motion that its r explains beside ``m[t-1]``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.log import Array
from rlco.gap.problem import Integers

LEADS = (0, 1, -1, -2)
_AXES = "xyz"


@dataclass(frozen=True)
class Motion:
    """What one recording tells of one kind of motion; T rows.

    Attributes:
        asked: The action's three numbers, (T, 3).
        target: The same, read as where the tool should be, (T, 3), [m] or [rad].
        place: Where the tool is, (T, 3) [m], or how it is turned: rotation vectors
            from the hand straight down, (T, 3) [rad].
        turn: The tool's axes in the base's frame, (T, 3, 3).
        angular: Whether this is of turns.
    """

    asked: Array
    target: Array
    place: Array
    turn: Array
    angular: bool = False

    def moved(self) -> Array:
        """Return the motion from each row to the next, (T - 1, 3), base frame."""
        if not self.angular:
            return np.diff(self.place, axis=0)
        turns = Rotation.from_rotvec(self.place)
        return np.asarray((turns[1:] * turns[:-1].inv()).as_rotvec())


@dataclass(frozen=True)
class ActionReading:
    """How three numbers of the action are written.

    Attributes:
        kind: ``delta``, or ``absolute``: where the tool should be.
        frame: Along whose axes: ``base`` or ``tool``.
        axes: Which number goes along x, y and z, as in ``("+x", "-z", "+y")``.
        lead: Rows between an action and the motion that it causes: 0 where a row
            holds what led to the action, 1 where it holds what the action led to.
    """

    kind: str = "delta"
    frame: str = "base"
    axes: tuple[str, str, str] = ("+x", "+y", "+z")
    lead: int = 0

    @property
    def matrix(self) -> Array:
        """The axes as a signed permutation, (3, 3)."""
        matrix = np.zeros((3, 3))
        for row, name in enumerate(self.axes):
            matrix[row, _AXES.index(name[1])] = 1.0 if name[0] == "+" else -1.0
        return matrix

    @property
    def deviations(self) -> int:
        """In how many ways it differs from the simulator's own."""
        straight = sum(name[1] == _AXES[i] for i, name in enumerate(self.axes))
        flipped = sum(name[0] == "-" for name in self.axes)
        other = (self.kind != "delta") + (self.frame != "base") + (self.lead != 0)
        return other + flipped + 2 * (straight < 3)

    def changes(self, what: str) -> list[str]:
        """Return what differs from the simulator, in words.

        Args:
            what: What the numbers are called, as in ``translations``.

        Example:
            >>> ActionReading(axes=("+x", "-y", "+z")).changes("translations")
            ['translations have y with the other sign']
        """
        words = []
        if self.kind == "absolute":
            words.append(f"{what} say where the tool should be, not how it should move")
        if self.frame == "tool":
            words.append(f"{what} go along the tool's axes, not the base's")
        if all(name[1] == _AXES[i] for i, name in enumerate(self.axes)):
            flipped = [name[1] for name in self.axes if name[0] == "-"]
            if flipped:
                words.append(f"{what} have {' and '.join(flipped)} with the other sign")
        else:
            order = ", ".join(name.replace("+", "") for name in self.axes)
            words.append(f"{what} have x, y, z as their {order}")
        return words


@dataclass(frozen=True)
class Score:
    """How well a reading explains the motion.

    Attributes:
        reading: The reading.
        explained: Part of the squared motion that it explains beside inertia.
        keep: k, the part of a step's motion that goes on in the next.
        gain: b, the part of what is asked that the tool goes at once.
        left: Mean square of what it leaves.
    """

    reading: ActionReading
    explained: float
    keep: float
    gain: float
    left: float


def scores(motions: Sequence[Motion], lead: int | None = None) -> list[Score]:
    """Score every reading, the best first.

    Args:
        motions: Of each recording.
        lead: Only readings with this lead; all by default.
    """
    found = []
    leads = LEADS if lead is None else (lead,)
    for kind, frame, rows in product(("delta", "absolute"), ("base", "tool"), leads):
        if kind == "absolute" and frame == "tool":
            continue
        moments = _moments(motions, ActionReading(kind, frame, lead=rows))
        found += [
            _score(ActionReading(kind, frame, axes, rows), moments)
            for axes in _signed_axes()
        ]
    return sorted(found, key=lambda s: (s.left, s.reading.deviations))


def score(motions: Sequence[Motion], reading: ActionReading) -> Score:
    """Return one reading's score."""
    return _score(reading, _moments(motions, reading))


def size(motions: Sequence[Motion], reading: ActionReading, nominal: Score) -> float:
    """Return what one of a log's numbers is worth to a tool that answers so.

    Args:
        motions: Of each recording.
        reading: How the actions are written.
        nominal: How the simulator's tool answers to metres, or to radians.
    """
    s, matrix = _moments(motions, reading), reading.matrix
    asked = float((matrix * s.ma).sum()) - nominal.keep * float((matrix * s.ba).sum())
    return asked / max(nominal.gain * s.aa, 1e-300)


def _signed_axes() -> Iterator[tuple[str, str, str]]:
    for order in permutations(_AXES):
        for signs in product("+-", repeat=3):
            x, y, z = (sign + axis for sign, axis in zip(signs, order, strict=True))
            yield x, y, z


@dataclass(frozen=True)
class _Moments:
    """Sums over rows: of motion m, motion before b, what is asked a, and place x."""

    mm: float
    bb: float
    mb: float
    ma: Array
    ba: Array
    aa: float
    mx: float
    bx: float
    xx: float
    xa: Array
    rows: int


def _moments(motions: Sequence[Motion], reading: ActionReading) -> _Moments:
    parts = [_aligned(motion, reading) for motion in motions]
    moved, before, asked, place = (
        np.concatenate([part[i] for part in parts]) for i in range(4)
    )
    if reading.kind == "absolute":
        # Where the frame's origin lies is free.
        asked = asked - asked.mean(axis=0)
        place = place - place.mean(axis=0)
    else:
        place = np.zeros_like(place)
    return _Moments(
        mm=float((moved**2).sum()),
        bb=float((before**2).sum()),
        mb=float((moved * before).sum()),
        ma=moved.T @ asked,
        ba=before.T @ asked,
        aa=float((asked**2).sum()),
        mx=float((moved * place).sum()),
        bx=float((before * place).sum()),
        xx=float((place**2).sum()),
        xa=place.T @ asked,
        rows=len(moved),
    )


def _aligned(
    motion: Motion, reading: ActionReading
) -> tuple[Array, Array, Array, Array]:
    """Return motion, the motion before it, what was asked and where, by row."""
    moved, lead = motion.moved(), reading.lead
    rows: Integers = np.arange(1, len(moved))
    rows = rows[(rows + lead >= 0) & (rows + lead < len(motion.asked))]
    now, before, turn = moved[rows], moved[rows - 1], motion.turn[rows]
    if reading.frame == "tool":
        now, before = (np.einsum("tji,tj->ti", turn, m) for m in (now, before))
    asked = motion.target if reading.kind == "absolute" else motion.asked
    return now, before, asked[rows + lead], motion.place[rows]


def _score(reading: ActionReading, s: _Moments) -> Score:
    matrix = reading.matrix
    # r = M a - x, with x zero for deltas.
    mr = float((matrix * s.ma).sum()) - s.mx
    br = float((matrix * s.ba).sum()) - s.bx
    rr = s.aa - 2.0 * float((matrix * s.xa).sum()) + s.xx
    alone = s.mm - s.mb**2 / max(s.bb, 1e-300)
    decay = s.bb * rr - br**2
    if decay <= 1e-9 * s.bb * rr or s.rows == 0:
        return Score(reading, 0.0, 0.0, 0.0, alone / max(s.rows, 1))
    keep = (s.mb * rr - mr * br) / decay
    gain = (mr * s.bb - s.mb * br) / decay
    if gain <= 0.0:
        return Score(reading, 0.0, 0.0, 0.0, alone / s.rows)
    left = max(s.mm - keep * s.mb - gain * mr, 0.0)
    explained = 1.0 - left / max(alone, 1e-300)
    return Score(reading, explained, keep, gain, left / s.rows)
