"""Times of a recording: uneven rows, dropped and repeated frames, backwards clocks."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError
from rlco.gap.logs.log import Array, Recording
from rlco.gap.logs.skipped_frames import resolution, skipped_frames

# Recordings are split at gaps longer than both: the commands meanwhile are unknown.
_LONG_PERIODS = 5.0
_LONG_SECONDS = 0.05
# A longer step than this many periods has lost a frame.
_LOST = 1.8
# ... unless that many do: then rows are uneven.
_LOST_SHARE = 0.1
# Times this near to even ones are even ones that were rounded, in periods.
_ROUNDING = 2e-3
# Worth a note, as a part of the period.
_JITTER = 0.1
# A piece between gaps needs this many rows to be of use.
_FEWEST_ROWS = 10


class Corrected(NamedTuple):
    """The parts of a recording, and notes."""

    parts: tuple[Recording, ...]
    notes: tuple[str, ...]


def correct_timing(recording: Recording) -> Corrected:
    """Check a recording's times, leave out repeated rows and split at long gaps.

    A row is a repetition where no measured number changed although the motion before
    and after says that they must have. Nothing is interpolated: uneven times stay as
    they are, and each part starts at 0 s.

    Args:
        recording: T rows.

    Returns:
        Its parts, and what was done, one sentence each.

    Raises:
        DataError: Times run backwards, or most of them do not rise.

    Example:
        >>> time = np.r_[np.arange(20) * 0.1, 5.0 + np.arange(20) * 0.1]
        >>> corrected = correct_timing(Recording("log", time))
        >>> [part.seconds.__round__(1) for part in corrected.parts]
        [1.9, 1.9]
        >>> corrected.notes
        ("'log' has a gap of 3.10 s after 1.90 s: it is split there.",)
    """
    name, notes = recording.name, []
    _refuse_backwards(name, recording.time)
    rising = np.r_[True, np.diff(recording.time) > 0]
    if not rising.all():
        lost = int((~rising).sum())
        _refuse_coarse(name, lost, len(rising))
        recording = recording.take(rising)
        notes.append(
            f"{name!r}: {lost} rows at the time of the row before are dropped."
        )
    recording = replace(recording, time=_evened(recording.time))
    for correct in (_later, _without_repeated):
        recording, said = correct(recording)
        notes += said
    notes += _unevenness(name, recording.time)
    parts, said = _split(recording)
    return Corrected(parts, (*notes, *said))


def _later(recording: Recording) -> tuple[Recording, list[str]]:
    """Move rows after frames that are missing from even times."""
    late = skipped_frames(recording)
    if not late.any():
        return recording, []
    shift = period_of(recording.time) * np.cumsum(late)
    note = (
        f"{recording.name!r}: all joints jump in {np.count_nonzero(late)} places by "
        f"whole steps, as if {late.sum()} frames were missing; later rows are taken to "
        "be later by as much."
    )
    return replace(recording, time=recording.time + shift), [note]


def _without_repeated(recording: Recording) -> tuple[Recording, list[str]]:
    repeated = repeated_rows(recording)
    if not repeated.any():
        return recording, []
    note = (
        f"{recording.name!r}: {int(repeated.sum())} of {len(repeated)} rows repeat the "
        "measurement before while the robot moves, and are dropped."
    )
    return recording.take(~repeated), [note]


def period_of(time: Array) -> float:
    """Return the usual step between times [s]: their median difference."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def repeated_rows(recording: Recording) -> NDArray[np.bool_]:
    """Return which rows repeat the measurement before them while it moves, (T,).

    Resting or sticking joints, and coarse encoders, rightly show the same numbers
    again. A repetition differs from them in the jump that ends it: it makes good for
    all the rows that were lost, at the speed before and after. Where most of a motion's
    steps are followed by repetitions the sensor is read more often than it measures.
    """
    measured = (recording.position, recording.pose, recording.torque)
    channels = [part for part in (*measured, recording.velocity) if part is not None]
    stale = np.zeros(recording.rows, dtype=np.bool_)
    if not channels or recording.rows < 5:
        return stale
    same = np.all([(p[1:] == p[:-1]).all(axis=1) for p in channels], axis=0)
    first = np.flatnonzero(np.r_[True, ~same])
    lost = np.diff(np.r_[first, recording.rows]) - 1
    # Where a robot was says more steadily than its torques whether it moves.
    steps = np.diff(channels[0][first], axis=0)
    quantum = resolution(channels[0])
    moving = (np.abs(steps) > 2.0 * quantum).any(axis=1)
    usual = float(np.median(lost[:-1][moving])) if moving.any() else 0.0
    for run in np.flatnonzero(lost):
        slow_sensor = usual >= 1 and lost[run] <= 2.0 * usual
        inside = 0 < run < len(steps) - 1
        if slow_sensor or (inside and _makes_good(steps, run, quantum, lost[run])):
            stale[first[run] + 1 : first[run] + 1 + lost[run]] = True
    return stale


def _makes_good(steps: Array, run: int, quantum: Array, lost: int) -> bool:
    """Whether a step makes up for lost rows of a steady motion."""
    near = [*range(max(run - 4, 0), run), *range(run + 1, min(run + 5, len(steps)))]
    # Some of the steps near may have lost rows as well, and be longer for it.
    speed = np.sign(steps[run - 1]) * np.percentile(np.abs(steps[near]), 25, axis=0)
    steady = (steps[run - 1] * steps[run + 1] > 0) & (np.abs(speed) > 2.0 * quantum)
    if not steady.any():
        return False
    jump, usual = steps[run][steady], speed[steady]
    short = np.abs(jump - usual).sum()
    return bool(np.abs(jump - (lost + 1) * usual).sum() < short)


def _refuse_backwards(name: str, time: Array) -> None:
    steps = np.diff(time)
    if (steps < 0).any():
        row = int((steps < 0).argmax()) + 1
        raise DataError(
            f"timestamps of {name!r} run backwards: {time[row]:.3f} s in row {row + 1} "
            f"follows {time[row - 1]:.3f} s; sort its rows, or mark recordings that "
            "share a file by a column 'episode'."
        )


def _refuse_coarse(name: str, lost: int, rows: int) -> None:
    if lost > rows / 2:
        raise DataError(
            f"{lost} of {rows} rows of {name!r} bear the time of the row before; write "
            "times with more digits."
        )


def _evened(time: Array) -> Array:
    """Return even times where these are even but for rounding."""
    time = np.asarray(time - time[0], dtype=float)
    if len(time) < 3:
        return time
    period = float(time[-1]) / (len(time) - 1)
    even = np.arange(len(time), dtype=float) * period
    return even if np.abs(time - even).max() <= _ROUNDING * period else time


def _unevenness(name: str, time: Array) -> list[str]:
    period, steps = period_of(time), np.diff(time)
    if not period:
        return []
    gaps = (steps > _LOST * period) & ~_is_long(steps, period)
    if gaps.mean() > _LOST_SHARE:
        gaps[:] = False
    jitter = float(steps[~gaps & ~_is_long(steps, period)].std())
    notes = []
    if jitter > _JITTER * period:
        notes.append(
            f"{name!r}: rows are uneven, {1e3 * period:.1f} ms apart with a jitter of "
            f"{1e3 * jitter:.1f} ms; their times are used as they are."
        )
    if gaps.any():
        lost = int(np.rint(steps[gaps] / period - 1.0).sum())
        notes.append(
            f"{name!r}: {lost} frames are missing in {int(gaps.sum())} places, at most "
            f"{1e3 * steps[gaps].max():.0f} ms apart; the command before holds there."
        )
    return notes


def _is_long(steps: Array, period: float) -> NDArray[np.bool_]:
    long: NDArray[np.bool_] = steps > max(_LONG_PERIODS * period, _LONG_SECONDS)
    return long


def _split(recording: Recording) -> tuple[tuple[Recording, ...], list[str]]:
    time, name = recording.time, recording.name
    steps = np.diff(time)
    gaps = np.flatnonzero(_is_long(steps, period_of(time)))
    if not len(gaps):
        return (recording,), []
    ends = [0, *(gaps + 1).tolist(), len(time)]
    parts, short = [], 0
    for number, (first, last) in enumerate(pairwise(ends)):
        if last - first < _FEWEST_ROWS:
            short += last - first
            continue
        part = recording.take(slice(first, last))
        named = f"{name} part {number + 1}"
        parts.append(replace(part, name=named, time=part.time - part.time[0]))
    notes = [
        f"{name!r} has a gap of {steps[gap]:.2f} s after {time[gap]:.2f} s: it is "
        "split there."
        for gap in gaps[:3].tolist()
    ]
    if len(gaps) > 3:
        notes.append(f"{name!r} has {len(gaps) - 3} more such gaps.")
    if short:
        notes.append(f"{name!r}: {short} rows between gaps are too few and left out.")
    return tuple(parts), notes
