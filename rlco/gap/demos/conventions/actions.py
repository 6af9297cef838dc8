"""Convention hypotheses of a log's actions, scored on the motion of the tool.

In a control step the tool moves by ``m[t] = k m[t-1] + b r[t]``, where r is the
commanded motion under a convention. The two coefficients describe the controller's
response. A convention's score is the share of the motion that its r explains beyond
``m[t-1]``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array

LEADS = (0, 1, -1, -2)
_AXES = "xyz"


@dataclass(frozen=True)
class Motion:
    """One kind of motion of one recording; T rows.

    Attributes:
        commanded: Three components of the action, (T, 3).
        target: The same, interpreted as the tool's target, (T, 3), [m] or [rad].
        position: The tool's position, (T, 3) [m], or its orientation: rotation vectors
            relative to the hand pointing straight down, (T, 3) [rad].
        turn: The tool's axes in the base frame, (T, 3, 3).
        angular: Whether this is rotation.
    """

    commanded: Array
    target: Array
    position: Array
    turn: Array
    angular: bool = False

    def moved(self) -> Array:
        """Return the motion from each row to the next, (T - 1, 3), base frame."""
        if not self.angular:
            return np.diff(self.position, axis=0)
        turns = Rotation.from_rotvec(self.position)
        return np.asarray((turns[1:] * turns[:-1].inv()).as_rotvec())


@dataclass(frozen=True)
class ActionConvention:
    """A convention of three components of the action.

    Attributes:
        kind: ``delta``, or ``absolute``: the tool's target.
        frame: Frame of the components: ``base`` or ``tool``.
        axes: Component along each of x, y and z, as in ``("+x", "-z", "+y")``.
        lead: Rows between an action and the motion that it causes: 0 where a row holds
            the state before its action, 1 where it holds the state after it.
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
        """Number of differences from the simulator's own convention."""
        straight = sum(name[1] == _AXES[i] for i, name in enumerate(self.axes))
        flipped = sum(name[0] == "-" for name in self.axes)
        other = (self.kind != "delta") + (self.frame != "base") + (self.lead != 0)
        return other + flipped + 2 * (straight < 3)

    def changes(self, what: str) -> list[str]:
        """Return differences from the simulator, one phrase each.

        Args:
            what: Name of the components, as in ``translations``.

        Example:
            >>> ActionConvention(axes=("+x", "-y", "+z")).changes("translations")
            ['translations have the sign of y flipped']
        """
        phrases = []
        if self.kind == "absolute":
            phrases.append(f"{what} are absolute targets, not relative motions")
        if self.frame == "tool":
            phrases.append(f"{what} are along the tool's axes, not the base's")
        if all(name[1] == _AXES[i] for i, name in enumerate(self.axes)):
            flipped = [name[1] for name in self.axes if name[0] == "-"]
            if flipped:
                phrases.append(
                    f"{what} have the sign of {' and '.join(flipped)} flipped"
                )
        else:
            order = ", ".join(name.replace("+", "") for name in self.axes)
            phrases.append(f"{what} have x, y, z as their {order}")
        return phrases


@dataclass(frozen=True)
class Score:
    """How well a convention explains the motion.

    Attributes:
        convention: The convention.
        explained: Share of the squared motion that it explains beyond inertia.
        keep: k, the share of a step's motion that persists in the next.
        gain: b, the share of the commanded motion made at once.
        residual: Mean square of the residual.
    """

    convention: ActionConvention
    explained: float
    keep: float
    gain: float
    residual: float


def scores(motions: Sequence[Motion], lead: int | None = None) -> list[Score]:
    """Score every convention, and return the best first.

    Args:
        motions: One for each recording.
        lead: Score only conventions with this lead; all by default.
    """
    found = []
    leads = LEADS if lead is None else (lead,)
    for kind, frame, rows in product(("delta", "absolute"), ("base", "tool"), leads):
        if kind == "absolute" and frame == "tool":
            continue
        moments = _moments(motions, ActionConvention(kind, frame, lead=rows))
        found += [
            _score(ActionConvention(kind, frame, axes, rows), moments)
            for axes in _signed_axes()
        ]
    return sorted(found, key=lambda s: (s.residual, s.convention.deviations))


def score(motions: Sequence[Motion], convention: ActionConvention) -> Score:
    """Return the score of one convention."""
    return _score(convention, _moments(motions, convention))


def size(
    motions: Sequence[Motion], convention: ActionConvention, nominal: Score
) -> float:
    """Return the size of one unit of a log's actions, given the controller's response.

    Args:
        motions: One for each recording.
        convention: Of the actions.
        nominal: Response of the simulated tool to metres or radians.
    """
    s, matrix = _moments(motions, convention), convention.matrix
    commanded = float((matrix * s.ma).sum()) - nominal.keep * float(
        (matrix * s.ba).sum()
    )
    return commanded / max(nominal.gain * s.aa, 1e-300)


def _signed_axes() -> Iterator[tuple[str, str, str]]:
    for order in permutations(_AXES):
        for signs in product("+-", repeat=3):
            x, y, z = (sign + axis for sign, axis in zip(signs, order, strict=True))
            yield x, y, z


@dataclass(frozen=True)
class _Moments:
    """Sums over rows: motion m, motion before b, command a, and position x."""

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


def _moments(motions: Sequence[Motion], convention: ActionConvention) -> _Moments:
    parts = [_aligned(motion, convention) for motion in motions]
    moved, before, commanded, position = (
        np.concatenate([part[i] for part in parts]) for i in range(4)
    )
    if convention.kind == "absolute":
        # The origin of the frame is unknown.
        commanded = commanded - commanded.mean(axis=0)
        position = position - position.mean(axis=0)
    else:
        position = np.zeros_like(position)
    return _Moments(
        mm=float((moved**2).sum()),
        bb=float((before**2).sum()),
        mb=float((moved * before).sum()),
        ma=moved.T @ commanded,
        ba=before.T @ commanded,
        aa=float((commanded**2).sum()),
        mx=float((moved * position).sum()),
        bx=float((before * position).sum()),
        xx=float((position**2).sum()),
        xa=position.T @ commanded,
        rows=len(moved),
    )


def _aligned(
    motion: Motion, convention: ActionConvention
) -> tuple[Array, Array, Array, Array]:
    """Return motion, previous motion, command and position, row by row."""
    moved, lead = motion.moved(), convention.lead
    rows: Integers = np.arange(1, len(moved))
    rows = rows[(rows + lead >= 0) & (rows + lead < len(motion.commanded))]
    now, before, turn = moved[rows], moved[rows - 1], motion.turn[rows]
    if convention.frame == "tool":
        now, before = (np.einsum("tji,tj->ti", turn, m) for m in (now, before))
    commanded = motion.target if convention.kind == "absolute" else motion.commanded
    return now, before, commanded[rows + lead], motion.position[rows]


def _score(convention: ActionConvention, s: _Moments) -> Score:
    matrix = convention.matrix
    # r = M a - x, with x zero for deltas.
    mr = float((matrix * s.ma).sum()) - s.mx
    br = float((matrix * s.ba).sum()) - s.bx
    rr = s.aa - 2.0 * float((matrix * s.xa).sum()) + s.xx
    alone = s.mm - s.mb**2 / max(s.bb, 1e-300)
    decay = s.bb * rr - br**2
    if decay <= 1e-9 * s.bb * rr or s.rows == 0:
        return Score(convention, 0.0, 0.0, 0.0, alone / max(s.rows, 1))
    keep = (s.mb * rr - mr * br) / decay
    gain = (mr * s.bb - s.mb * br) / decay
    if gain <= 0.0:
        return Score(convention, 0.0, 0.0, 0.0, alone / s.rows)
    residual = max(s.mm - keep * s.mb - gain * mr, 0.0)
    explained = 1.0 - residual / max(alone, 1e-300)
    return Score(convention, explained, keep, gain, residual / s.rows)
