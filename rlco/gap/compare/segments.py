"""Segments of recordings that are rolled out from measured states."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array, Recording
from rlco.gap.logs.times.timing import is_even

SETTLE = 0.3  # time in which an arm forgets a wrong initial velocity [s]


@dataclass(frozen=True)
class Segment:
    """A segment of a recording, rolled out from a measured state.

    Attributes:
        recording: Index of the recording.
        first: Its first row, where the rollout starts.
        begin: The first row that is compared.
        last: Its last row.
        steps: Physics steps from the recording's first command to the segment's row.
        commands: Physics steps of the segment.
        frames: Step of the segment before each compared row, (rows,).
        weights: Fraction from that step to the next at which the row lies, (rows,).
        state: Positions and velocities at the first row, (2, joints).
    """

    recording: int
    first: int
    begin: int
    last: int
    steps: int
    commands: int
    frames: Integers
    weights: Array
    state: Array


def held_commands(
    recording: Recording,
    step: float,
    size: int,
    columns: list[int],
    late: Array | None = None,
) -> Array:
    """Return the commands at each physics step, held between rows, (steps, nu).

    They begin `earlier_steps` before the recording's first row, and hold
    `Recording.unread`.

    Args:
        recording: The recording.
        step: The physics step [s].
        size: Number of actuators, nu.
        columns: Actuator of each command.
        late: How much later than the row each row's command takes effect, (rows,) [s];
            None where none is known to. Each changes what is held by as much as if
            all before it had arrived, so that the sum is linear in each.
    """
    before = earlier_steps(recording, step)
    steps = before + round(recording.seconds / step) + 1
    times = recording.time[0] + step * (np.arange(steps) - before)
    time, sent = recording.time, np.asarray(recording.command, dtype=float)
    if late is not None:
        time = time + late
    if recording.unread is not None:
        time = np.concatenate([recording.unread[0], time])
        order = np.argsort(time, kind="stable")
        time, sent = time[order], np.concatenate([recording.unread[1], sent])[order]
    commands = np.zeros((steps, size))
    if late is not None:
        commands[:, columns] = _sums(time, sent, times, step)
    elif is_even(recording.time):
        # A row takes effect at the step nearest to it in time.
        row = np.searchsorted(time, times + 0.5 * step, side="right") - 1
        commands[:, columns] = sent[row]
    else:
        commands[:, columns] = _means(time, sent, times, step)
    return commands


def _sums(time: Array, sent: Array, times: Array, step: float) -> Array:
    """Return what changes at given times add up to, (steps, columns)."""
    changes = np.diff(sent, axis=0, prepend=0.0)
    late = np.r_[times[0], time[1:]]
    return np.cumsum(changes_at(late - times[0], changes, step, len(times)), axis=0)


def changes_at(time: Array, changes: Array, step: float, steps: int) -> Array:
    """Return changes at given times as what each physics step adds, (steps, columns).

    A held command that changes within a step is, on average over it, a part of the new.

    Args:
        time: Of each, from the first step's begin, (rows,) [s].
        changes: (rows, columns).
        step: The physics step [s].
        steps: How many.

    Example:
        >>> changes_at(np.array([0.015]), np.array([[4.0]]), 0.01, 4).ravel().tolist()
        [0.0, 2.0, 2.0, 0.0]
    """
    place = np.clip(time / step, 0.0, steps - 1.0)
    at = place.astype(int)
    part = (place - at)[:, None]
    found = np.zeros((steps + 1, changes.shape[1]))
    np.add.at(found, at, (1.0 - part) * changes)
    np.add.at(found, at + 1, part * changes)
    return found[:-1]


def _means(time: Array, sent: Array, times: Array, step: float) -> Array:
    """Return the mean of held commands in the step that begins at each time."""
    total = np.zeros_like(sent)
    np.cumsum(sent[:-1] * np.diff(time)[:, None], axis=0, out=total[1:])

    def until(times: Array) -> Array:
        row = np.clip(np.searchsorted(time, times, side="right") - 1, 0, None)
        return np.asarray(total[row] + sent[row] * (times - time[row])[:, None])

    return np.asarray((until(times + step) - until(times)) / step)


def earlier_steps(recording: Recording, step: float) -> int:
    """Return the physics steps of the commands before a recording's first row."""
    if recording.unread is None:
        return 0
    # Rounded down: the first of them has a command.
    since = recording.time[0] - float(recording.unread[0][0])
    return max(0, int(since / step + 1e-6))


def joint_velocity(recording: Recording) -> Array:
    """Return logged velocities, or those derived from positions, (T, joints)."""
    from scipy.signal import savgol_filter  # seconds, for recordings without speeds

    if recording.velocity is not None:
        return np.asarray(recording.velocity, dtype=float)
    period = float(np.median(np.diff(recording.time)))
    rows = min(9, recording.rows - (recording.rows + 1) % 2)
    return np.asarray(
        savgol_filter(recording.position, rows, min(3, rows - 1), 1, period, axis=0)
    )


def segments_of(
    index: int, recording: Recording, step: float, horizon: float | None
) -> list[Segment]:
    """Divide a recording into the segments that are rolled out.

    Args:
        index: Its index in the log.
        recording: The recording.
        step: The physics step [s].
        horizon: Length of a segment [s]; None for the whole recording.
    """
    rows = recording.rows
    period = float(np.median(np.diff(recording.time)))
    length = rows - 1 if horizon is None else max(2, round(horizon / period))
    velocity = joint_velocity(recording)
    earlier = earlier_steps(recording, step)
    position = np.asarray(recording.position, dtype=float)
    # A velocity derived from positions is poor at the first row of a recording.
    settle = 0 if recording.velocity is not None else round(SETTLE / period)
    settle = min(settle, max(0, rows - 3))
    segments = []
    for first in range(0, rows - 2, length):
        last = min(first + length, rows - 1)
        begin = round((recording.time[first] - recording.time[0]) / step)
        begin_row = first + 1 + (settle if horizon is None else 0)
        exact = (recording.time[begin_row : last + 1] - recording.time[0]) / step
        exact = exact - begin
        near = np.round(exact)
        exact = np.where(np.abs(exact - near) < 1e-3, near, exact)
        frames = np.floor(exact).astype(np.int64)
        steps = int(frames[-1]) + 1
        state = np.stack([position[first], velocity[first]])
        segments.append(
            Segment(
                index,
                first,
                begin_row,
                last,
                earlier + begin,
                steps,
                frames,
                exact - frames,
                state,
            )
        )
    return segments


def parts_of(
    segments: list[Segment], hypotheses: int, threads: int
) -> list[list[Segment]]:
    """Split the segments if there are too few hypotheses to occupy all threads."""
    if hypotheses >= 4 * threads or len(segments) < threads:
        return [segments]
    bounds = np.linspace(0, len(segments), threads + 1).astype(int)
    return [segments[a:b] for a, b in pairwise(bounds)]
