"""When rows were read, where their stamps are uneven: a clock's ticks, or the stamps.

A robot that moves tells: at a wrong time its position is off by speed times that error,
and sixth differences, in which smooth motion vanishes, are larger. Between both lies
reading that jitters and is stamped badly besides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array, Recording
from rlco.gap.logs.times.clock import Clock, clock_of, in_step
from rlco.gap.logs.times.misplaced_rows import misplaced_rows
from rlco.gap.logs.times.repeated_rows import repeated_rows
from rlco.gap.logs.times.sixth_differences import ORDER, sixth_differences

# Stamps this near to a clock are its ticks, but for rounding, in periods.
ROUNDING = 2e-3
# The share of the stamps' jitter that is real must be known as well as this.
_SURE = 0.2
# A share nearer than this to none or all of it is none or all of it.
_NEAR = 0.02
# Steps shorter than this many periods are no times that a motion can have.
_SHORTEST = 0.05
_AROUND = 21  # windows in which the motion is about as smooth


def at_read_times(
    recordings: Sequence[Recording],
) -> tuple[list[Recording], list[str]]:
    """Return recordings with the times that their motion fits best, and notes.

    All are of one logger. Where the motion cannot tell, stamps stay as they are.

    Args:
        recordings: With stamps in the order of the rows.

    Example:
        >>> random, ticks = np.random.default_rng(0), np.arange(600) * 0.02
        >>> path = np.sin(ticks[:, None] * [2.0, 3.0])
        >>> path += random.normal(0.0, 1e-4, path.shape)
        >>> stamps = ticks + random.normal(0.0, 0.003, 600)
        >>> (found,), notes = at_read_times([Recording("log", stamps, path)])
        >>> bool(np.abs(np.diff(found.time) - 0.02).max() < 1e-5)
        True
        >>> notes
        ['The stamps jitter by 3.1 ms about a regular clock of 20.0 ms, which the \
motion fits better: rows are taken at its ticks.']
    """
    found = [_on_a_clock(recording) for recording in recordings]
    clocks = [clock for _, clock in found if clock is not None]
    if not clocks:
        return list(recordings), []
    shared = iter(in_step(clocks))
    found = [(one, clock and next(shared)) for one, clock in found]
    share = _real_share([(one, clock) for one, clock in found if clock is not None])
    if share is None and any((np.diff(one.time) < 0).any() for one in recordings):
        share = 0.0  # rows were written in the order of reading
    if share is None or share == 1.0:
        return list(recordings), []
    jitter = max(clock.jitter for clock in clocks)
    unknown = jitter * math.sqrt(share * (1.0 - share))
    timed = [
        recording if clock is None else _timed(kept, clock, share)
        for recording, (kept, clock) in zip(recordings, found, strict=True)
    ]
    period = float(np.median([clock.period for clock in clocks]))
    note = (
        f"The stamps jitter by {1e3 * jitter:.1f} ms about a regular clock of "
        f"{1e3 * period:.1f} ms, which the motion fits better: rows are taken at its "
        "ticks."
    )
    if share:
        note = (
            f"The stamps jitter by {1e3 * jitter:.1f} ms about a regular clock of "
            f"{1e3 * period:.1f} ms, of which the motion shows {share:.0%}: rows are "
            f"taken at the most likely times between, and {1e3 * unknown:.1f} ms of "
            "doubt are in the noise."
        )
    return timed, [note]


def _timed(kept: Recording, clock: Clock, share: float) -> Recording:
    measured = _measured(kept)
    if share == 0.0 and measured is not None:
        repeated = repeated_rows(kept)
        fresh = np.flatnonzero(~repeated)
        # Without it, the first that repeats a misplaced row would pass for a fresh one.
        of = np.maximum(np.cumsum(~repeated) - 1, 0)
        wrong = misplaced_rows(clock.ticks[fresh], measured[fresh])[of]
        kept, clock = kept.take(~wrong), clock._replace(ticks=clock.ticks[~wrong])
    time = clock.time + share * (kept.time - clock.time)
    unknown = clock.jitter * math.sqrt(share * (1.0 - share))
    return replace(kept, time=time, jitter=unknown)


def _on_a_clock(recording: Recording) -> tuple[Recording, Clock | None]:
    """Return a recording without rows that were written twice, and its clock."""
    measured = _measured(recording)
    if measured is None:
        return recording, None
    twice = np.diff(recording.time) == 0
    twice &= (measured[1:] == measured[:-1]).all(axis=1)
    kept = recording.take(~np.r_[False, twice]) if twice.any() else recording
    clock = clock_of(kept.time)
    if clock is None:
        return recording, None
    if np.abs(kept.time - clock.time).max() <= ROUNDING * clock.period:
        return recording, None  # its times are its ticks
    return kept, clock


def _measured(recording: Recording) -> Array | None:
    return recording.pose if recording.position is None else recording.position


def _real_share(found: Sequence[tuple[Recording, Clock]]) -> float | None:
    """Return how much of the stamps' jitter is the sampling's, 0 to 1; None: unknown.

    Differences at times between ticks and stamps lie between theirs, so the share that
    leaves least of them is a linear fit.
    """
    rows = [windows for one, clock in found for windows in _windows(one, clock)]
    if not rows:
        return None
    ticks, stamps = (np.concatenate([row[i] for row in rows]) for i in (0, 1))
    smooth = np.concatenate([row[2] for row in rows])
    noise = np.median(np.minimum(np.abs(ticks), np.abs(stamps)), axis=0)
    weight = 1.0 / np.maximum(smooth + noise**2, 1e-30)
    change = ticks - stamps
    power = float((weight * change**2).sum())
    if power == 0.0:
        return None
    share = float((weight * ticks * change).sum()) / power
    rest = ticks - share * change
    # Neighbouring windows share all but one of their rows.
    error = math.sqrt((ORDER + 1) * float(((weight * change * rest) ** 2).sum()))
    error /= power
    if error > _SURE:
        return None
    near = max(_NEAR, 2.0 * error)
    if share < near:
        return 0.0
    return 1.0 if share > 1.0 - near else share


def _windows(recording: Recording, clock: Clock) -> Iterator[tuple[Array, ...]]:
    """Give differences at the ticks, at the stamps, and their usual square nearby."""
    from scipy.ndimage import uniform_filter1d  # not needed for logs on a clock

    measured = _measured(recording)
    fresh = ~repeated_rows(recording)
    if measured is None or fresh.sum() <= ORDER + _AROUND:
        return
    values = measured[fresh]
    ticks, _ = sixth_differences(clock.time[fresh], values)
    with np.errstate(divide="ignore", invalid="ignore"):
        stamps, _ = sixth_differences(recording.time[fresh], values)
    least = np.minimum(ticks**2, stamps**2)
    smooth = uniform_filter1d(np.nan_to_num(least, posinf=0.0), _AROUND, axis=0)
    possible = _possible(recording.time[fresh], clock.period)
    yield ticks[possible], stamps[possible], smooth[possible]


def _possible(stamps: Array, period: float) -> NDArray[np.bool_]:
    """Return which windows have stamps that rise by more than a trifle."""
    short = np.r_[0, np.cumsum(np.diff(stamps) < _SHORTEST * period)]
    inside: NDArray[np.bool_] = short[ORDER:] == short[:-ORDER]
    return inside
