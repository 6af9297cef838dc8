"""Find commands that each arrive late by a time of their own, where much is left.

Whoever sends commands over a network or from a busy computer has them arrive late by
other times, and each moves the joints as an unknown torque would. Where the likelihood
of such times is clearly the best on recordings that were not fitted
(`rlco.gap.search.lateness`), the time of each command is estimated from the motion of
all joints, and the search begins again with commands at these times: other effects are
then found as in a log whose commands were in time. What is named in the end is the
distribution of the times, `random_delay`.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace

import numpy as np

from rlco.gap.compare.arm.late_commands import Responses, responses
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.segments import SETTLE, joint_velocity
from rlco.gap.logs.log import Array
from rlco.gap.search.intervals import NORMAL
from rlco.gap.search.judge import NEAR_FLOOR
from rlco.gap.search.lateness import (
    Lateness,
    apart_likelihood,
    estimated,
    fit_common,
    fit_each,
    fit_quiet,
    fit_row_times,
    joint_sums,
    log_likelihood,
    quiet_likelihood,
    row_time_likelihood,
    spread_interval,
)
from rlco.gap.search.setting import Setting
from rlco.gap.search.state import State
from rlco.gap.search.steps.elsewhere import Additions
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.command import COMMAND_DELAY, CONTROL_RATE, RANDOM_DELAY

CLEARLY = 20.0  # logarithm of the likelihood ratio, held out
GAIN = 0.3  # share of the held-out error that the commands' times must remove
# A slow controller holds commands until its next turn; times of their own would fit as
# well, and what its turns leave besides. Only where it leaves much more is it none.
TURNS = 2.0
_ROUNDS = 5  # estimates of the times, each with responses at the one before
_DELAY = 0.05  # standard deviation of a constant delay [s]


def late_commands(state: State, additions: Additions) -> Generator[State, None, State]:
    """Yield the state after each step of a search with commands at their own times.

    Args:
        state: Of a search that has added and dropped its effects.
        additions: How a search goes on.

    Returns:
        Its last state, with the times; the given state where commands do not clearly
        arrive late at random.
    """
    setting = state.setting
    problem, needed = setting.problem, {RANDOM_DELAY.name, COMMAND_DELAY.name}
    if state.best.error <= NEAR_FLOOR or not isinstance(problem, ArmRollouts):
        return state
    # With one joint, nothing tells a late command from a torque.
    if len(problem.log.joints) < 2 or needed & setting.excluded:
        return state
    names = {effect.name for effect in state.best.effects}
    if CONTROL_RATE.name in names and state.best.error < TURNS:
        return state
    lateness = _estimate(setting, problem, _with_delay(state))
    if lateness is None:
        return state
    begun = start(
        problem.with_late_commands(lateness.late),
        spread=float(np.max(setting.prior, initial=0.0)),
        exclude=setting.excluded,
    )
    begun = replace(begun, trail=state.trail, lateness=lateness)
    found = begun = begun.noted(effects=(), late_commands=True)
    for step in additions(begun):
        found = step
        yield state  # what was found with other commands is kept aside until whole
    return found if found.best.error < (1.0 - GAIN) * state.best.error else state


def _with_delay(state: State) -> Hypothesis:
    """Return the best effects with a constant delay, from which the others vary."""
    # A slow controller stands for late commands until their times are known.
    slow = CONTROL_RATE.name
    effects = tuple(one for one in state.best.effects if one.name != slow)
    if any(effect.name == COMMAND_DELAY.name for effect in effects):
        return Hypothesis(effects)
    (known,) = COMMAND_DELAY.parameters(state.setting.problem.model, None)
    delays = [
        AppliedEffect(COMMAND_DELAY.name, None, {known.name: size})
        for size in known.starts
    ]
    _, fits = state.fit([(*effects, delay) for delay in delays])
    return Hypothesis(fits[0].effects if fits else effects)


def _estimate(
    setting: Setting, problem: ArmRollouts, hypothesis: Hypothesis
) -> Lateness | None:
    """Return how late each command is; None where that is not clearly at random."""
    logs = problem.log.recordings
    late: Sequence[Array] = [np.zeros(one.rows) for one in logs]
    ends = np.cumsum([one.rows for one in logs])[:-1]
    lateness = None
    for number in range(_ROUNDS):
        moved = problem.with_late_commands(late) if number else problem
        found = responses(moved, hypothesis, late)
        if found is None:
            return None
        # The residual as it would be with commands in time, to first order.
        residual = moved.residuals([hypothesis])[0] - found.by(np.concatenate(late))
        values = _beside(setting, found, residual)
        # The last is the most accurate; one round suffices to see that there is none.
        if number in (0, _ROUNDS - 1):
            fitted, held = _gains(setting, problem, found, values)
            if min(fitted, held if number else fitted) < CLEARLY:
                return None
        sums = joint_sums(found, values, problem.noise)
        spread, excess = fit_common(sums, fit_each(sums)[1])
        times = estimated(sums, spread, excess)
        if np.abs(times).max() > 0.5 * SETTLE:
            return None  # no command is: something else is at work
        late = np.split(times, ends)
        width = spread_interval(sums, spread, excess, NORMAL)
        lateness = Lateness(problem, late, spread, width)
    return lateness


def _beside(setting: Setting, found: Responses, rows: Array) -> Array:
    """Return residuals, and what else may change them, in units of the noise.

    That is a constant further delay, and the model's tolerance: (N, 2 + spread).
    """
    tolerance = setting.weights.moved * setting.prior[:, None]
    columns = np.stack([rows, _DELAY * found.sum(), *tolerance], axis=1)
    return np.asarray(columns / setting.problem.noise[found.channel][:, None])


def _gains(
    setting: Setting, problem: ArmRollouts, found: Responses, values: Array
) -> tuple[float, float]:
    """Return how much likelier common times are than all else, fitted and held out.

    Both are logarithms; everything is fitted to the training recordings.
    """
    noise, channel = problem.noise, found.channel
    train = np.isin(found.block, setting.train)
    fitted = joint_sums(found.part(train), values[train], noise)
    spreads, excess = fit_each(fitted)
    spread, common = fit_common(fitted, excess)
    quiet = fit_quiet(fitted)
    speed = _speeds(problem) / noise[channel]
    times = [
        fit_row_times(values[train], speed[train], size, channel[train])
        for size in (quiet, excess)
    ]
    gains = []
    for part in (train, ~train):
        sums = joint_sums(found.part(part), values[part], noise)
        others = [
            quiet_likelihood(sums, quiet),
            apart_likelihood(sums, spreads, excess),
            *(
                row_time_likelihood(values[part], speed[part], size, channel[part], t)
                for size, t in zip((quiet, excess), times, strict=True)
            ),
        ]
        gains.append(log_likelihood(sums, spread, common) - max(others))
    return gains[0], gains[1]


def _speeds(problem: ArmRollouts) -> Array:
    """Return the velocity of each residual's joint, (N,)."""
    logs = problem.log.recordings
    return np.concatenate(
        [
            joint_velocity(logs[one.recording])[one.begin : one.last + 1].ravel()
            for one in problem.segments
        ]
    )
