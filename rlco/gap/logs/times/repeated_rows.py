"""Rows that repeat the measurement before them although the robot moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array, Recording
from rlco.gap.logs.times.encoder_step import encoder_step
from rlco.gap.logs.times.skipped_frames import resolution

# Longer repetitions are a rest, which has no noise in a simulation.
_SHORT = 5


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
    several = sum(part.shape[1] for part in channels) > 1
    if (
        several
        and lost.max() <= _SHORT
        and any(encoder_step(joint) == 0.0 for joint in channels[0].T)
    ):
        stale[1:] = same
        return stale
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
