"""Estimate by how much each command is late, where that is clearly at random.

A joint's response to a late command is linear in its time only while that is short
beside the servo's own and no motor reaches its limits. So the times are estimated,
applied as far as the simulation then comes nearer, and estimated again from responses
measured where they then are. Where and as long as much is left, the first order is not
to be trusted, and counts as little as noise of that size would let it: else times far
off would be fitted to what it neglects (the damping of Levenberg and Marquardt, by
rows). Only in the end is the common time of all joints held against times that each
joint has of its own, since later commands move quick joints otherwise than slow ones
and at first seem to be late by other times at each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from rlco.gap.compare.arm.commands.late import Responses, responses
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import SETTLE, joint_velocity
from rlco.gap.logs.log import Array
from rlco.gap.search.intervals import NORMAL
from rlco.gap.search.lateness import (
    Lateness,
    apart_likelihood,
    beside,
    estimated,
    fit_common,
    fit_each,
    fit_quiet,
    fit_row_times,
    fit_spread,
    joint_sums,
    log_likelihood,
    quiet_likelihood,
    row_time_likelihood,
    spread_interval,
)
from rlco.gap.search.setting import Setting

CLEARLY = 20.0  # logarithm of the likelihood ratio, held out
TURNS = 0.15  # power of times at one frequency from which a slow controller is there
_DELAY = 0.05  # standard deviation of a constant delay [s]
_ROUNDS = 12  # estimates of the times, each with responses at the one before
_PARTS = (1.0, 0.5, 0.2)  # of a step that are tried
_BLOCK = 0.5  # in which a step may be longer than in others [s]
_SMALLER = 0.05  # share of the squares that a round must remove to be followed
_NEGLECTED = 0.5  # part of what is left nearby that the first order may be wrong by


@dataclass(frozen=True)
class _Times:
    """Times of commands, and what the simulation leaves with them.

    Attributes:
        late: How late each command is, (C,) [s].
        residual: Of all recordings, (N,).
    """

    late: Array
    residual: Array


@dataclass(frozen=True)
class _Goal:
    """The likeliest times to first order.

    Attributes:
        late: How late each command is, (C,) [s].
        mean: Of the times' distribution [s].
        spread: Its standard deviation [s].
        tolerance: What the model's tolerance changes, (N,).
    """

    late: Array
    mean: float
    spread: float
    tolerance: Array


def command_times(
    setting: Setting, problem: ArmRollouts, hypothesis: Hypothesis
) -> Lateness | None:
    """Return how late each command is; None where that is not clearly at random.

    Args:
        setting: Which recordings are fitted, and the model's tolerance.
        problem: The robot and its log.
        hypothesis: What acts, with a constant delay that the times vary about.
    """
    commands = sum(one.rows for one in problem.log.recordings)
    now = _Times(np.zeros(commands), problem.residuals([hypothesis])[0])
    whole = _Groups.of(problem, np.inf)
    for number in range(_ROUNDS):
        moved = _moved(problem, now.late) if number else problem
        found = responses(moved, hypothesis, _by_recording(problem, now.late))
        if found is None:
            return None
        # The residual as it would be with commands in time, to first order.
        values = _beside(setting, found, now.residual - found.by(now.late))
        trusted: Array = np.ones(len(values))
        if number == 0:  # which suffices to see that no times are behind it
            gains = _gains(setting, problem, found, values, trusted)
            if gains.coarse < CLEARLY:
                return None
        trusted = _trusted(problem, now.residual)
        goal = _goal(problem, found, values, trusted)
        before = whole.squares(problem, goal, trusted, now).sum()
        now = _nearer(problem, hypothesis, goal, trusted, now)
        after = whole.squares(problem, goal, trusted, now).sum()
        if number == _ROUNDS - 1 or after > (1.0 - _SMALLER) * before:
            return _named(setting, problem, found, values, trusted, goal, now)
    return None


def _named(
    setting: Setting,
    problem: ArmRollouts,
    found: Responses,
    values: Array,
    trusted: Array,
    goal: _Goal,
    now: _Times,
) -> Lateness | None:
    """Return the times that were found, if they are common to all joints."""
    gains = _gains(setting, problem, found, values, trusted)
    if min(gains.fitted, gains.held) < CLEARLY:
        return None
    sums = joint_sums(*_weighted(found, values, trusted), problem.noise)
    spread, excess = fit_common(sums, np.ones(len(sums)))
    width = spread_interval(sums, spread, excess, NORMAL)
    late = _by_recording(problem, now.late - goal.mean)
    if in_turns(problem, late) > TURNS:
        return None
    return Lateness(problem, late, spread, width)


def in_turns(problem: ArmRollouts, late: Sequence[Array]) -> float:
    """Return how far commands take effect in the turns of a slow controller, 0 to 1.

    The largest power of the times at one frequency, mean of the recordings: 1 if all
    take effect at multiples of a period that is longer than that of the rows, and near
    0 if they do at random.

    Args:
        problem: The robot and its log.
        late: Of each recording, how late each command is, (rows,) [s].
    """
    logs = problem.log.recordings
    longest = max(one.seconds for one in logs)
    period = float(np.median(np.concatenate([np.diff(one.time) for one in logs])))
    frequency = np.arange(1.0 / SETTLE, 1.0 / (1.5 * period), 0.25 / longest)
    power = np.zeros(len(frequency))
    for one, times in zip(logs, late, strict=True):
        # While nothing moves, nothing shows when a command arrives.
        sent = np.asarray(one.command, dtype=float)
        change = np.abs(np.diff(sent, axis=0, prepend=sent[:1]))
        moved = change.max(axis=1)
        at = (one.time + times)[moved >= np.median(moved)]
        phase = 2.0 * np.pi * np.outer(frequency, at)
        power += np.abs(np.exp(1j * phase).mean(axis=1)) ** 2 / len(logs)
    return float(power.max(initial=0.0))


def _by_recording(problem: ArmRollouts, late: Array) -> list[Array]:
    ends = np.cumsum([one.rows for one in problem.log.recordings])[:-1]
    return np.split(late, ends)


def _moved(problem: ArmRollouts, late: Array) -> ArmRollouts:
    return problem.with_late_commands(_by_recording(problem, late))


def _trusted(problem: ArmRollouts, residual: Array) -> Array:
    """Return by how much each residual counts less than by its noise, (N,).

    What a first-order estimate neglects grows with what is left around a row.
    """
    layout, joints = problem.layout, len(problem.noise)
    squares = (residual / problem.noise[layout.channel]) ** 2
    times = np.concatenate([np.diff(one.time) for one in problem.log.recordings])
    rows = max(3, round(SETTLE / float(np.median(times))))
    nearby = np.empty_like(squares)
    for one in np.unique(layout.recording):
        some = layout.recording == one
        of = squares[some].reshape(-1, joints)
        nearby[some] = uniform_filter1d(of, rows, axis=0, mode="nearest").ravel()
    return np.asarray(1.0 / np.maximum(1.0, _NEGLECTED * np.sqrt(nearby)))


def _weighted(
    found: Responses, values: Array, trusted: Array
) -> tuple[Responses, Array]:
    column = trusted[:, None]
    return replace(found, rows=found.rows * column), values * column


def _goal(
    problem: ArmRollouts, found: Responses, values: Array, trusted: Array
) -> _Goal:
    weighted = _weighted(found, values, trusted)
    sums = joint_sums(*weighted, problem.noise)
    excess = np.ones(len(sums))
    spread = fit_spread(sums, excess)
    amounts = beside(sums, spread, excess)
    late = estimated(sums, spread, excess)
    mean = -_DELAY * float(amounts[0])
    tolerance = values[:, 2:] @ amounts[1:] * problem.noise[found.channel]
    return _Goal(np.clip(late + mean, -SETTLE, SETTLE), mean, spread, tolerance)


@dataclass(frozen=True)
class _Groups:
    """Groups of commands and residuals that are hardly moved by other commands.

    Attributes:
        command: Group of each command, (C,).
        row: Group of each residual, (N,).
        count: How many groups.
    """

    command: Integers
    row: Integers
    count: int

    @classmethod
    def of(cls, problem: ArmRollouts, seconds: float) -> _Groups:
        """Return parts of this length [s] of each recording."""
        logs, layout = problem.log.recordings, problem.layout
        begins = np.array([one.time[0] for one in logs])
        most = 1 + int(max(one.seconds for one in logs) / seconds)

        def group(recording: Integers, time: Array) -> Integers:
            part = ((time - begins[recording]) / seconds).astype(np.int64)
            return np.asarray(recording * most + part)

        recording = np.repeat(np.arange(len(logs)), [one.rows for one in logs])
        time = np.concatenate([one.time for one in logs])
        rows = group(layout.recording, layout.time)
        return cls(group(recording, time), rows, most * len(logs))

    def squares(
        self, problem: ArmRollouts, goal: _Goal, trusted: Array, now: _Times
    ) -> Array:
        """Return of each group the sum of squares that the goal makes least."""
        noise = problem.noise[problem.layout.channel]
        rows = (now.residual - goal.tolerance) / noise * trusted
        times = (now.late - goal.mean) / goal.spread
        squares = np.bincount(self.command, times**2, self.count)
        return np.asarray(squares + np.bincount(self.row, rows**2, self.count))


def _nearer(
    problem: ArmRollouts,
    hypothesis: Hypothesis,
    goal: _Goal,
    trusted: Array,
    now: _Times,
) -> _Times:
    """Return times as far towards the goal as is likeliest, in each recording."""

    def simulated(late: Array) -> _Times:
        return _Times(late, _moved(problem, late).residuals([hypothesis])[0])

    step = goal.late - now.late
    trials = [now, *(simulated(now.late + part * step) for part in _PARTS)]
    # A motor at its limit at one time must not hold back the others.
    for seconds in (_BLOCK, np.inf):
        groups = _Groups.of(problem, seconds)
        squares = [groups.squares(problem, goal, trusted, one) for one in trials]
        # Infinite where it diverges.
        best = np.argmin(np.where(np.isfinite(squares), squares, np.inf), axis=0)
        late = np.stack([one.late for one in trials])
        mixed = late[best[groups.command], np.arange(late.shape[1])]
        trials.append(simulated(mixed))
    return trials[-1]


def _beside(setting: Setting, found: Responses, rows: Array) -> Array:
    """Return residuals, and what else may change them, in units of the noise.

    That is a constant further delay, and the model's tolerance: (N, 2 + spread).
    """
    tolerance = setting.weights.moved * setting.prior[:, None]
    columns = np.stack([rows, _DELAY * found.sum(), *tolerance], axis=1)
    return np.asarray(columns / setting.problem.noise[found.channel][:, None])


@dataclass(frozen=True)
class _Gains:
    """How much likelier common times are than all else, fitted to the training.

    Attributes:
        coarse: Logarithm, of the training, over all but times of each joint.
        fitted: The same over all.
        held: The same of the recordings held out.
    """

    coarse: float
    fitted: float
    held: float


def _gains(
    setting: Setting,
    problem: ArmRollouts,
    found: Responses,
    values: Array,
    trusted: Array,
) -> _Gains:
    """Return how much likelier common times are than all else."""
    noise, channel = problem.noise, found.channel
    found, values = _weighted(found, values, trusted)
    train = np.isin(found.block, setting.train)
    fitted = joint_sums(found.part(train), values[train], noise)
    spreads, excess = fit_each(fitted)
    spread, common = fit_common(fitted, excess)
    quiet = fit_quiet(fitted)
    speed = _speeds(problem) / noise[channel] * trusted
    times = [
        fit_row_times(values[train], speed[train], size, channel[train])
        for size in (quiet, excess)
    ]
    coarse, each = [], []
    for part in (train, ~train):
        sums = joint_sums(found.part(part), values[part], noise)
        others = [
            quiet_likelihood(sums, quiet),
            *(
                row_time_likelihood(values[part], speed[part], size, channel[part], t)
                for size, t in zip((quiet, excess), times, strict=True)
            ),
        ]
        common_times = log_likelihood(sums, spread, common)
        coarse.append(common_times - max(others))
        each.append(common_times - apart_likelihood(sums, spreads, excess))
    return _Gains(coarse[0], min(coarse[0], each[0]), min(coarse[1], each[1]))


def _speeds(problem: ArmRollouts) -> Array:
    """Return the velocity of each residual's joint, (N,)."""
    logs = problem.log.recordings
    return np.concatenate(
        [
            joint_velocity(logs[one.recording])[one.begin : one.last + 1].ravel()
            for one in problem.segments
        ]
    )
