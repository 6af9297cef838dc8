"""Commands of rows that are missing from a log: sent all the same, or not at all.

A logger that loses a row loses a command that the robot got; a loop that skips a turn
sends none. Which it was, the motion after the missing rows tells: at once, or later
where commands are late.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.logs.times.timing import missing_frames
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.command import COMMAND_DELAY

_AROUND = 11  # rows in which the residual is about as rough
_LATEST = 12  # half rows by which commands may be late
_SENT = 0.25  # share of the change by lost commands that shows that they were sent
_APART = 6  # commands of which one is left out: others are the neighbours of another
_WIDER = 2.0  # a lost command's error over those of the commands beside it


def with_missing_commands(
    spec: mujoco.MjSpec, log: Log, noise: Array, horizon: float, threads: int
) -> Log:
    """Return a log with the commands of missing rows, if its motion shows them.

    Both are simulated, held and interpolated. Their difference is a bump after each
    missing row; the share of it in what the simulation with held commands lacks says
    which fits better. Second differences leave the bumps and little of any gap but a
    delay, so both are simulated with the delay that leaves least of them.

    Args:
        spec: The robot's model.
        log: Commands and positions.
        noise: Of each joint's positions, (joints,).
        horizon: Length of the rollouts that are compared [s].
        threads: Rollouts that run in parallel.

    Returns:
        The log with a note, in `Recording.unread` the commands, and in
        `Recording.guessed` how far off they may be; as it is where no row is missing.
    """
    filled = [filled_in(recording) for recording in log.recordings]
    rows = sum(len(_lost_times(recording)) for recording in log.recordings)
    if all(a is b for a, b in zip(filled, log.recordings, strict=True)):
        return log
    both = replace(log, recordings=(*log.recordings, *filled))
    problem = ArmRollouts(spec, both, noise, horizon=horizon, threads=threads)
    count, joints = len(log.recordings), len(log.joints)
    every = range(2 * count)
    as_held, as_sent = every[:count], every[count:]
    period = float(np.median(np.concatenate([np.diff(r.time) for r in log.recordings])))
    recording = problem.layout.recording
    parts = recording[recording < count].reshape(-1, joints)[:, 0]
    hypotheses = [_late(half_rows * period / 2.0) for half_rows in range(_LATEST + 1)]
    held = problem.residuals(hypotheses, as_held).reshape(_LATEST + 1, -1, joints)
    delay = int(np.argmin([_rough(one, parts) for one in held]))
    sent = problem.residuals([hypotheses[delay]], as_sent)[0].reshape(-1, joints)
    share = _share(held[delay], sent, parts, noise)
    if share < _SENT:
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
    they step. How far off they may be, `Recording.guessed`, is by how much commands
    beside them would be missed.

    Example:
        >>> time = np.delete(np.arange(40) * 0.1, [7, 12, 13])
        >>> filled = filled_in(Recording("log", time, command=time[:, None]))
        >>> filled.unread[0].round(3).tolist(), filled.unread[1][:, 0].round(3).tolist()
        ([0.7, 1.2, 1.3], [0.7, 1.2, 1.3])
        >>> filled.guessed[:, 0].round(3).tolist()
        [0.0, 0.0, 0.0]
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
    known = time[~np.isin(time, recording.time)]
    every = np.r_[known, lost]
    off = np.concatenate(
        [np.zeros((len(known), sent.shape[1])), _off(time, sent, lost)]
    )
    order = np.argsort(every)
    return replace(
        recording, unread=(every[order], line(every[order])), guessed=off[order]
    )


def _off(time: Array, sent: Array, lost: Array) -> Array:
    """Return how far off interpolated commands may be, (L, actuators).

    Args:
        time: Of the commands that are known, (M,) [s].
        sent: These, (M, actuators).
        lost: Times of the others, (L,) [s].
    """
    from scipy.interpolate import Akima1DInterpolator

    error, row = np.zeros_like(sent), np.arange(len(time))
    for turn in range(_APART):
        out = row % _APART == turn
        # Nothing is known beyond the first and the last.
        out[[0, -1]] = False
        line = Akima1DInterpolator(time[~out], sent[~out], axis=0, method="makima")
        error[out] = np.abs(sent[out] - line(time[out]))
    after = np.clip(np.searchsorted(time, lost), 1, len(time) - 1)
    return np.asarray(_WIDER * np.maximum(error[after - 1], error[after]))


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


def _late(delay: float) -> Hypothesis:
    if delay == 0.0:
        return Hypothesis()
    return Hypothesis((AppliedEffect(COMMAND_DELAY.name, None, {"delay": delay}),))


def _rough(residual: Array, parts: Integers) -> float:
    """Return how rough a residual (rows, joints) is, in logarithms of the joints'."""
    second = _second(residual, parts)
    if not np.isfinite(second).all():
        return np.inf
    return float(np.log(np.mean(second**2, axis=0) + 1e-300).sum())


def _second(values: Array, parts: Integers) -> Array:
    """Return second differences of values (rows, joints) within each recording."""
    same = parts[2:] == parts[:-2]
    return np.asarray(np.diff(values, n=2, axis=0)[same])


def _share(held: Array, sent: Array, parts: Integers, noise: Array) -> float:
    """Return how much of the change by commands the residual shows, 1 for all.

    A joint counts the less, the more its residual changes there for other reasons.
    """
    from scipy.ndimage import uniform_filter1d

    change, rest = _second(held - sent, parts), _second(held, parts)
    finite = np.isfinite(change).all(axis=1) & np.isfinite(rest).all(axis=1)
    change, rest = change[finite], rest[finite]
    least = np.minimum(np.abs(rest), np.abs(rest - change))
    around = uniform_filter1d(least**2, _AROUND, axis=0)
    weight = 1.0 / (around + noise**2)
    power = float((weight * change**2).sum())
    return float((weight * rest * change).sum()) / power if power else 0.0
