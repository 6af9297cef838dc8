"""Frames that are missing although the times do not show it.

Many recorders number their frames and compute the times: where one came late, or was
lost, all joints jump at once by a whole number of their usual steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array, Recording

# Joints that must agree: one that moves alone may jump for reasons of its own.
_JOINTS = 2
# A motion is steady where the steps on both sides differ by less than this share.
_STEADY = 0.4
# Steps this many times the encoder's own are a motion.
_STEPS = 4.0
# How near to a whole number of steps, and how alike in all joints, a jump must be.
_WHOLE = 0.2
# A log in which fewer frames than these are missing has none missing.
_FEWEST = 2


def skipped_frames(recording: Recording) -> NDArray[np.int64]:
    """Return how many frames are missing before each row, (T,), zero mostly.

    Example:
        >>> place = np.delete(np.arange(200.0), [20, 130, 131])[:, None]
        >>> path = np.sin(place * [0.03, 0.02])
        >>> found = skipped_frames(Recording("log", np.arange(197) * 0.02, path))
        >>> np.flatnonzero(found).tolist(), found[[20, 129]].tolist()
        ([20, 129], [1, 2])
    """
    none = np.zeros(recording.rows, dtype=np.int64)
    position, period = recording.position, np.diff(recording.time)
    if position is None or recording.rows < 10 or position.shape[1] < _JOINTS:
        return none
    if np.ptp(period) > 0.01 * period.mean():
        return none
    found = none.copy()
    found[1:] = _lost(np.diff(position, axis=0), resolution(position))
    if recording.command is not None:
        # What was sent meanwhile is missing as well.
        sent = np.diff(recording.command, axis=0)
        found[1:][_ratio(sent, resolution(recording.command))[0] < 1.4] = 0
    return found if np.count_nonzero(found) >= _FEWEST else none


def resolution(values: Array) -> Array:
    """Return the smallest difference between two readings of each column.

    Example:
        >>> resolution(np.array([[0.0, 1.0], [0.5, 1.0], [1.5, 1.0]]))
        array([0.5, 0. ])
    """
    gaps = np.diff(np.sort(values, axis=0), axis=0)
    smallest = np.where(gaps > 0, gaps, np.inf).min(axis=0, initial=np.inf)
    return np.asarray(np.where(np.isfinite(smallest), smallest, 0.0))


def _lost(steps: Array, quantum: Array) -> NDArray[np.int64]:
    ratio, unlike, joints = _ratio(steps, quantum)
    ratio = np.where(np.isfinite(ratio), ratio, 1.0)
    count = np.rint(ratio).astype(np.int64) - 1
    sure = (count >= 1) & (np.abs(ratio - count - 1) < _WHOLE) & (unlike < _WHOLE)
    return np.where(sure & (joints >= _JOINTS), count, 0)


def _ratio(steps: Array, quantum: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Compare each step with its neighbours, in the columns that move steadily.

    Returns:
        How many usual steps it is, infinite where nothing moves steadily; by what
        share it differs from that in direction; and how many columns those are.
    """
    before, after = steps[:-2], steps[2:]
    usual = (before + after) / 2.0
    moving = np.abs(usual) > _STEPS * quantum
    moving &= np.abs(after - before) < _STEADY * np.abs(usual)
    usual, jump = np.where(moving, usual, 0.0), np.where(moving, steps[1:-1], 0.0)
    power = (usual**2).sum(axis=1)
    still = power == 0
    ratio = (usual * jump).sum(axis=1) / np.where(still, 1.0, power)
    apart = np.linalg.norm(jump - ratio[:, None] * usual, axis=1)
    size = np.linalg.norm(jump, axis=1)
    unlike = apart / np.where(size == 0, 1.0, size)
    edge = (1, 1)
    return (
        np.pad(np.where(still, np.inf, ratio), edge, constant_values=1.0),
        np.pad(unlike, edge),
        np.pad(moving.sum(axis=1), edge),
    )
