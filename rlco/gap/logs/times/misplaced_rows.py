"""Rows beside missing ones that are not of their tick, as the motion says.

Whether rows came before a lost one or after it, bad stamps cannot tell; nor that a
logger wrote the lost row's measurement into the next. A moving robot can: such a row is
a whole period's way from where its neighbours put it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array
from rlco.gap.logs.times.sixth_differences import sixth_differences

_LONGEST = 3  # rows in a row that may all be a tick off
_BESIDE = 2  # neighbours on each side that say where rows belong
_REACH = _LONGEST + 2 * _BESIDE  # rows between runs that share no neighbour
_WITHIN = 8.0  # ticks in which a motion is smooth
_OFF = 6.0  # deviations of the noise by which a row is plainly not of its tick
_SHARE = 0.3  # ... of which this much may be left at another tick that is free

Rows = tuple[int, ...]


def misplaced_rows(ticks: Array, values: Array) -> NDArray[np.bool_]:
    """Return which rows fit a free tick beside theirs, and theirs not at all, (T,).

    Args:
        ticks: Tick of each row, rising, (T,).
        values: Measured positions, (T, joints).

    Example:
        >>> ticks = np.delete(np.arange(60.0), 30)
        >>> path = np.sin(0.1 * ticks[:, None] * [1.0, 2.0])
        >>> path += np.random.default_rng(0).normal(0.0, 1e-3, path.shape)
        >>> ticks[28:30] += 1.0  # these came before the missing row
        >>> np.flatnonzero(misplaced_rows(ticks, path)).tolist()
        [28, 29]
    """
    found = np.zeros(len(ticks), dtype=np.bool_)
    high, _ = sixth_differences(ticks, values)
    noise = np.median(np.abs(high), axis=0) / 0.6745 if len(high) else np.zeros(1)
    if not (noise > 0).all():
        return found
    kept, known = np.arange(len(ticks)), dict[Rows, float]()
    while runs := _worst(ticks, values, kept, noise, known):
        rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        found[kept[rows]] = True
        kept = np.delete(kept, rows)
    return found


def _worst(
    ticks: Array,
    values: Array,
    kept: NDArray[np.intp],
    noise: Array,
    known: dict[Rows, float],
) -> list[slice]:
    """Return the runs of kept rows that are plainly off by most, of the shortest.

    A single row that is off makes those beside it seem so, which are more. So of runs
    that share neighbours only the worst is among them.

    Args:
        ticks: As in `misplaced_rows`.
        values: As in `misplaced_rows`.
        kept: The rows that are left, (K,).
        noise: Of each column, (joints,).
        known: By how much runs are off, by the rows that say so; others are added.
    """
    left, measured = ticks[kept], values[kept]
    for size in range(1, _LONGEST + 1):
        runs = _runs(left, size)
        off = np.zeros(len(runs))
        for number, run in enumerate(runs):
            # The rows that matter for it: the same once more, where none of them went.
            rows = kept[max(run.start - 2 * _BESIDE, 0) : run.stop + _BESIDE]
            key = size, run.stop == len(left), *rows.tolist()
            if key not in known:
                known[key] = _wrong(left, measured, run, noise)
            off[number] = known[key]
        near = np.zeros(len(left), dtype=np.bool_)
        chosen = []
        for number in np.argsort(-off, kind="stable").tolist():
            if off[number] < _OFF:
                break
            run = runs[number]
            if not near[run].any():
                chosen.append(run)
            near[max(run.start - _REACH, 0) : run.stop + _REACH] = True
        if chosen:
            return chosen
    return []


def _runs(ticks: Array, size: int) -> list[slice]:
    """Return the runs of rows beside a missing one, and the last row."""
    firsts = {
        first
        for gap in np.flatnonzero(np.diff(ticks) > 1).tolist()
        for first in (gap - size + 1, gap + 1)
        if _BESIDE <= first <= len(ticks) - size - _BESIDE
    }
    last = {len(ticks) - 1} if size == 1 and len(ticks) > 2 * _BESIDE else set()
    return [slice(first, first + size) for first in sorted(firsts | last)]


def _wrong(ticks: Array, values: Array, run: slice, noise: Array) -> float:
    """Return by how much a run is off, 0 where it is not of other free ticks."""
    first, end = run.start, run.stop
    near = np.r_[first - _BESIDE : first, end : end + _BESIDE]
    if end == len(ticks):
        near = np.arange(first - 2 * _BESIDE, first)
    # Damaged stamps need not rise, and the last may be any time after.
    if np.ptp(ticks[near[0] : max(near[-1] + 1, end)]) > _WITHIN:
        return 0.0
    earlier = int(ticks[first] - ticks[first - 1]) - 1
    # The last row may be of the tick after, too.
    later = int(ticks[end] - ticks[end - 1]) - 1 if end < len(ticks) else 1
    off = {
        moved: max(
            _off(ticks[row] + moved, ticks[near], values[near], values[row], noise)
            for row in range(first, end)
        )
        for moved in range(-earlier, later + 1)
    }
    if 0 not in off:  # stamps of another time, between neighbours of this
        return 0.0
    now = off[0]
    return now if min(off.values()) < _SHARE * now else 0.0


def _off(tick: float, near: Array, values: Array, value: Array, noise: Array) -> float:
    """Return how far a row is from the cubic through its neighbours, in its noise."""
    apart = near[:, None] - near[None, :]
    np.fill_diagonal(apart, 1.0)
    ahead = np.where(np.eye(4, dtype=bool), 1.0, tick - near[None, :])
    weights = (ahead / apart).prod(axis=1)
    spread = noise * np.sqrt(1.0 + (weights**2).sum())
    return float(np.sqrt(np.mean(((value - weights @ values) / spread) ** 2)))
