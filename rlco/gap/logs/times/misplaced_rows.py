"""Rows beside missing ones that are not of their tick, as the motion says.

Whether a row came before a lost one or after it, a bad stamp cannot tell; nor that a
logger wrote the lost row's measurement into the next. A moving robot can: such a row is
a whole period's way from where its neighbours put it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array
from rlco.gap.logs.times.sixth_differences import sixth_differences

_NEIGHBOURS = np.array((-2, -1, 1, 2))
_WITHIN = 8.0  # ticks in which a motion is smooth
_OFF = 6.0  # deviations of the noise by which a row is plainly not of its tick
_SHARE = 0.3  # ... of which this much may be left at another tick that is free


def misplaced_rows(ticks: Array, values: Array) -> NDArray[np.bool_]:
    """Return which rows fit a free tick beside theirs, and theirs not at all, (T,).

    Args:
        ticks: Tick of each row, rising, (T,).
        values: Measured positions, (T, joints).

    Example:
        >>> ticks = np.delete(np.arange(60.0), 30)
        >>> path = np.sin(0.1 * ticks[:, None] * [1.0, 2.0])
        >>> path += np.random.default_rng(0).normal(0.0, 1e-3, path.shape)
        >>> ticks[29] = 30.0  # it came before the missing row
        >>> np.flatnonzero(misplaced_rows(ticks, path)).tolist()
        [29]
    """
    found = np.zeros(len(ticks), dtype=np.bool_)
    high, _ = sixth_differences(ticks, values)
    noise = np.median(np.abs(high), axis=0) / 0.6745 if len(high) else np.zeros(1)
    if not (noise > 0).all():
        return found
    kept = np.arange(len(ticks))
    while True:
        steps = np.diff(ticks[kept])
        gaps = np.flatnonzero(steps > 1)
        beside = np.unique(np.r_[gaps, gaps + 1])
        beside = beside[(beside >= 2) & (beside < len(kept) - 2)]
        off = [_wrong(ticks[kept], values[kept], int(row), noise) for row in beside]
        if max(off, default=0.0) < _OFF:
            return found
        worst = int(beside[int(np.argmax(off))])
        found[kept[worst]] = True
        kept = np.delete(kept, worst)


def _wrong(ticks: Array, values: Array, row: int, noise: Array) -> float:
    """Return by how much a row is off, 0 where it is not of another free tick."""
    near = row + _NEIGHBOURS
    if ticks[near[-1]] - ticks[near[0]] > _WITHIN:
        return 0.0
    free = np.arange(ticks[row - 1] + 1.0, ticks[row + 1])
    off = [_off(tick, ticks[near], values[near], values[row], noise) for tick in free]
    here = np.flatnonzero(free == ticks[row])
    if not len(here):  # times so large that floats have no ticks between them
        return 0.0
    now = off[int(here[0])]
    return now if min(off) < _SHARE * now else 0.0


def _off(tick: float, near: Array, values: Array, value: Array, noise: Array) -> float:
    """Return how far a row is from the cubic through its neighbours, in its noise."""
    apart = near[:, None] - near[None, :]
    np.fill_diagonal(apart, 1.0)
    ahead = np.where(np.eye(4, dtype=bool), 1.0, tick - near[None, :])
    weights = (ahead / apart).prod(axis=1)
    spread = noise * np.sqrt(1.0 + (weights**2).sum())
    return float(np.sqrt(np.mean(((value - weights @ values) / spread) ** 2)))
