"""Times of a recording: uneven rows, dropped and repeated frames, backwards clocks."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError, counted
from rlco.gap.logs.log import Array, Recording
from rlco.gap.logs.times.read_times import ROUNDING
from rlco.gap.logs.times.repeated_rows import repeated_rows
from rlco.gap.logs.times.skipped_frames import skipped_frames

# Recordings are split at gaps longer than both: the commands meanwhile are unknown.
_LONG_PERIODS = 5.0
_LONG_SECONDS = 0.05
# A longer step than this many periods has lost a frame.
_LOST = 1.8
# ... unless that many do: then rows are uneven.
_LOST_SHARE, _LOST_TICKS = 0.1, 0.3
# Differences from whole periods, in periods, that rounding explains.
_EVEN = 0.02
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
    they are (see `rlco.gap.logs.times.read_times`), and each part starts at 0 s.

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
        dropped = counted(lost, "row")
        notes.append(f"{name!r}: dropped {dropped} at the time of the row before.")
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
    return replace(recording.take(~repeated), unread=_sent(recording, repeated)), [note]


def _sent(
    recording: Recording, repeated: NDArray[np.bool_]
) -> tuple[Array, Array] | None:
    """Return times and commands of repeated rows whose command is no repetition."""
    sent = recording.command
    if sent is None:
        return None
    fresh = repeated & np.r_[True, (sent[1:] != sent[:-1]).any(axis=1)]
    return (recording.time[fresh], sent[fresh]) if fresh.any() else None


def unread_between(
    recording: Recording, start: float, end: float
) -> tuple[Array, Array] | None:
    """Return `Recording.unread` from one time to another, the first of them as zero."""
    if recording.unread is None:
        return None
    time, sent = recording.unread
    inside = (time >= start) & (time <= end)
    return (time[inside] - start, sent[inside]) if inside.any() else None


def period_of(time: Array) -> float:
    """Return the usual step between times [s]: their median difference."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


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
    return even if np.abs(time - even).max() <= ROUNDING * period else time


def _unevenness(name: str, time: Array) -> list[str]:
    period, steps = period_of(time), np.diff(time)
    if not period:
        return []
    lost = missing_frames(time)
    jitter = float(steps[(lost == 0) & ~_is_long(steps, period)].std())
    notes = []
    if jitter > _JITTER * period:
        notes.append(
            f"{name!r}: rows are uneven, {1e3 * period:.1f} ms apart with a jitter of "
            f"{1e3 * jitter:.1f} ms; their times are used as they are."
        )
    if lost.any():
        notes.append(
            f"{name!r}: {lost.sum()} frames are missing in {np.count_nonzero(lost)} "
            f"places, at most {1e3 * steps[lost > 0].max():.0f} ms apart."
        )
    return notes


def is_even(time: Array) -> bool:
    """Return whether times are multiples of one period, some of which may be left."""
    ticks = np.diff(time) / period_of(time)
    return bool(np.abs(ticks - np.round(ticks)).max(initial=0.0) < _EVEN)


def missing_frames(time: Array) -> NDArray[np.int64]:
    """Return how many frames are missing after each row but the last, (T - 1,).

    None are where so many would be that the rows are uneven instead. On the ticks of a
    clock, which `is_even` tells, more may be.
    """
    period, steps = period_of(time), np.diff(time)
    if not period:
        return np.zeros(len(steps), dtype=np.int64)
    gaps = (steps > _LOST * period) & ~_is_long(steps, period)
    if gaps.mean() > (_LOST_TICKS if is_even(time) else _LOST_SHARE):
        gaps[:] = False
    lost = np.rint(steps / period - 1.0).astype(np.int64)
    return np.where(gaps, lost, 0)


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
        start, end = part.time[0], part.time[-1]
        parts.append(
            replace(
                part,
                name=f"{name} part {number + 1}",
                time=part.time - start,
                unread=unread_between(recording, start, end),
            )
        )
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
