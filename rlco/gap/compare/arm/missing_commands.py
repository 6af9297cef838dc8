"""Commands of rows that are missing from a log: sent all the same, or not at all.

A logger that loses a row loses a command that the robot got; a loop that skips a turn
sends none. Which it was, the motion just after the missing rows tells.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.logs.times.timing import missing_frames

_AROUND = 11  # rows in which the residual is about as rough


def with_missing_commands(
    spec: mujoco.MjSpec, log: Log, noise: Array, horizon: float, threads: int
) -> Log:
    """Return a log with the commands of missing rows, if its motion shows them.

    Both are simulated, held and interpolated. Their difference is a bump after each
    missing row; the share of it in what the simulation with held commands lacks says
    which fits better. Second differences leave the bumps and little of any gap.

    Args:
        spec: The robot's model.
        log: Commands and positions.
        noise: Of each joint's positions, (joints,).
        horizon: Length of the rollouts that are compared [s].
        threads: Rollouts that run in parallel.

    Returns:
        The log with a note, in `Recording.unread` the commands; as it is where no row
        is missing.
    """
    filled = [filled_in(recording) for recording in log.recordings]
    rows = sum(len(_lost_times(recording)) for recording in log.recordings)
    if all(a is b for a, b in zip(filled, log.recordings, strict=True)):
        return log
    both = replace(log, recordings=(*log.recordings, *filled))
    problem = ArmRollouts(spec, both, noise, horizon=horizon, threads=threads)
    count = len(log.recordings)
    held, sent = (
        problem.residuals([Hypothesis()], range(first, first + count))[0]
        for first in (0, count)
    )
    joints, recording = len(log.joints), problem.layout.recording
    parts = recording[recording < count].reshape(-1, joints)[:, 0]
    share = _share(held.reshape(-1, joints), sent.reshape(-1, joints), parts, noise)
    if share < 0.5:
        note = f"the command before holds in {rows} missing rows"
        return replace(log, notes=(*log.notes, f"By the motion, {note}."))
    note = (
        f"The commands of {rows} missing rows are interpolated: the motion fits them "
        "better than the command before."
    )
    return replace(log, recordings=tuple(filled), notes=(*log.notes, note))


def filled_in(recording: Recording) -> Recording:
    """Return a recording with commands of its missing rows, interpolated, in `unread`.

    Modified Akima interpolation: smooth where commands are, and without overshoot where
    they step.

    Example:
        >>> time = np.delete(np.arange(40) * 0.1, [7, 12, 13])
        >>> filled = filled_in(Recording("log", time, command=time[:, None]))
        >>> filled.unread[0].round(3).tolist(), filled.unread[1][:, 0].round(3).tolist()
        ([0.7, 1.2, 1.3], [0.7, 1.2, 1.3])
    """
    from scipy.interpolate import Akima1DInterpolator  # seconds, for whole logs

    lost = _lost_times(recording)
    if recording.command is None or not len(lost):
        return recording
    time, sent = recording.time, recording.command
    if recording.unread is not None:
        time = np.r_[recording.unread[0], time]
        order = np.argsort(time, kind="stable")
        time, sent = time[order], np.concatenate([recording.unread[1], sent])[order]
    line = Akima1DInterpolator(time, sent, axis=0, method="makima")
    every = np.r_[time[~np.isin(time, recording.time)], lost]
    order = np.argsort(every)
    return replace(recording, unread=(every[order], line(every[order])))


def _lost_times(recording: Recording) -> Array:
    """Return the times of missing rows whose command is not known either, (L,) [s]."""
    lost, time = missing_frames(recording.time), recording.time
    places = [
        time[row] + (time[row + 1] - time[row]) * np.arange(1, n + 1) / (n + 1)
        for row, n in zip(np.flatnonzero(lost), lost[lost > 0], strict=True)
    ]
    found = np.concatenate(places) if places else np.zeros(0)
    if recording.unread is None or not len(found):
        return found
    known, period = recording.unread[0], float(np.median(np.diff(time)))
    apart = np.abs(found[:, None] - known[None, :]).min(axis=1)
    return np.asarray(found[apart > 0.5 * period])


def _share(held: Array, sent: Array, parts: Integers, noise: Array) -> float:
    """Return how much of the change by commands the residual shows, 1 for all.

    A joint counts the less, the more its residual changes there for other reasons.
    """
    from scipy.ndimage import uniform_filter1d

    edges = np.r_[0, np.flatnonzero(np.diff(parts)) + 1, len(parts)]
    changes, lacking = [], []
    for first, last in pairwise(edges.tolist()):
        change = np.diff((held - sent)[first:last], n=2, axis=0)
        rest = np.diff(held[first:last], n=2, axis=0)
        if np.isfinite(change).all() and np.isfinite(rest).all():
            changes.append(change)
            lacking.append(rest)
    if not changes:
        return 0.0
    change, rest = np.concatenate(changes), np.concatenate(lacking)
    least = np.minimum(np.abs(rest), np.abs(rest - change))
    around = uniform_filter1d(least**2, _AROUND, axis=0)
    weight = 1.0 / (around + noise**2)
    power = float((weight * change**2).sum())
    return float((weight * rest * change).sum()) / power if power else 0.0
