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
    recording: Recording, step: float, size: int, columns: list[int]
) -> Array:
    """Return the commands at each physics step, held between rows, (steps, nu).

    They begin `earlier_steps` before the recording's first row, and hold
    `Recording.unread`.
    """
    times = command_steps(recording, step)
    time, sent, _ = sent_commands(recording)
    commands = np.zeros((len(times), size))
    if is_even(recording.time):
        # A row takes effect at the step nearest to it in time.
        row = np.searchsorted(time, times + 0.5 * step, side="right") - 1
        commands[:, columns] = sent[row]
    else:
        commands[:, columns] = _means(time, sent, times, step)
    return commands


def command_steps(recording: Recording, step: float) -> Array:
    """Return the times of the physics steps that commands are held in, (steps,) [s]."""
    before = earlier_steps(recording, step)
    steps = before + round(recording.seconds / step) + 1
    return np.asarray(recording.time[0] + step * (np.arange(steps) - before))


def sent_commands(recording: Recording) -> tuple[Array, Array, Integers]:
    """Return all commands in the order of their times, those of no row included.

    Returns:
        Times (M,) [s], commands (M, actuators), and the row of each, or -1, (M,).
    """
    time, sent = recording.time, np.asarray(recording.command, dtype=float)
    row = np.arange(len(time))
    if recording.unread is None:
        return time, sent, row
    time = np.concatenate([recording.unread[0], time])
    order = np.argsort(time, kind="stable")
    sent = np.concatenate([recording.unread[1], sent])
    row = np.r_[np.full(len(recording.unread[0]), -1), row]
    return time[order], sent[order], row[order]


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
