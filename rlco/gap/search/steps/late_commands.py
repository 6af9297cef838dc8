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

from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rlco.gap.compare.arm.late_commands import Responses, responses
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.segments import SETTLE, joint_velocity
from rlco.gap.logs.log import Array
from rlco.gap.search.intervals import NORMAL
from rlco.gap.search.judge import NAMED, NEAR_FLOOR, kind
from rlco.gap.search.lateness import (
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
from rlco.gap.search.setting import Scored, Setting
from rlco.gap.search.state import State
from rlco.gap.search.steps.elsewhere import Additions
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.command import COMMAND_DELAY, CONTROL_RATE, RANDOM_DELAY

CLEARLY = 20.0  # logarithm of the likelihood ratio, held out
GAIN = 0.3  # share of the held-out error that the commands' times must remove
_ROUNDS = 5  # estimates of the times, each with responses at the one before
_DELAY = 0.05  # standard deviation of a constant delay [s]
_LATE = 0.3  # a mean of fewer spreads is none: commands would come early as often


@dataclass(frozen=True)
class Lateness:
    """Estimated times of a log's commands.

    Attributes:
        problem: The problem as logged.
        late: By recording, how much later than its row, and than the mean, each
            command took effect, (rows,) [s].
        spread: Standard deviation of these times [s].
        width: Half the width of its 90 % interval [s].
    """

    problem: ArmRollouts
    late: Mapping[int, Array]
    spread: float
    width: float


def late_commands(
    state: State, additions: Additions
) -> Generator[State, None, tuple[State, Lateness | None]]:
    """Yield the state after each step of a search with commands at their own times.

    Args:
        state: Of a search that has added and dropped its effects.
        additions: How a search goes on.

    Returns:
        Its last state, and the times; the given state and None where commands do not
        clearly arrive late at random.
    """
    setting = state.setting
    problem, needed = setting.problem, {RANDOM_DELAY.name, COMMAND_DELAY.name}
    if state.best.error <= NEAR_FLOOR or not isinstance(problem, ArmRollouts):
        return state, None
    # With one joint, nothing tells a late command from a torque.
    if len(problem.log.joints) < 2 or needed & setting.excluded:
        return state, None
    found = _estimate(setting, problem, _with_delay(state))
    if found is None:
        return state, None
    again = start(
        problem.with_late_commands(found.late),
        spread=float(np.max(setting.prior, initial=0.0)),
        exclude=setting.excluded,
    )
    again = replace(again, trail=state.trail).noted(effects=(), late_commands=True)
    yield again
    for step in additions(again):
        again = step
        yield again
    if again.best.error > (1.0 - GAIN) * state.best.error:
        return state, None
    return again, found


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
    late: dict[int, Array] = {i: np.zeros(one.rows) for i, one in enumerate(logs)}
    ends = np.cumsum([one.rows for one in logs])
    slices = [slice(end - one.rows, end) for end, one in zip(ends, logs, strict=True)]
    lateness = None
    for number in range(_ROUNDS):
        moved = problem.with_late_commands(late) if number else problem
        found = responses(moved, hypothesis, late)
        if found is None:
            break
        # The residual as it would be with commands in time, to first order.
        before = np.concatenate([late[index] for index in range(len(logs))])
        residual = moved.residuals([hypothesis])[0] - found.by(before)
        values = _beside(setting, found, residual)
        # The last is the most accurate; one round suffices to see that there is none.
        if number in (0, _ROUNDS - 1):
            fitted, held = _gains(setting, problem, found, values)
            if min(fitted, held if number else fitted) < CLEARLY:
                return None
        sums = joint_sums(found, values, problem.noise)
        spread, excess = fit_common(sums, fit_each(sums)[1])
        times = estimated(sums, spread, excess)
        # Whatever all have in common is the constant delay's.
        times = times - np.average(times, weights=found.weights())
        if np.abs(times).max() > 0.5 * SETTLE:
            return None  # no command is: something else is at work
        late.update({index: times[rows] for index, rows in enumerate(slices)})
        width = spread_interval(sums, spread, excess, NORMAL)
        lateness = Lateness(problem, dict(late), spread, width)
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


def with_random_delay(state: State, lateness: Lateness) -> State:
    """Return a closed state that names `random_delay` for its constant delay.

    Where no delay is named, commands took effect early as often as late, which is a
    matter of the log's times and not of the robot.

    Args:
        state: After the steps `intervals` and `residual`.
        lateness: The times of the commands.
    """
    state = _before_as_logged(state, lateness)
    effects = state.best.effects
    place = {effect.name: index for index, effect in enumerate(effects)}
    at = place.get(COMMAND_DELAY.name)
    if at is None or kind(state) not in NAMED:
        return state
    mean = float(effects[at].values[0])
    if mean < _LATE * lateness.spread:
        return state
    values = {"mean": mean, "spread": lateness.spread}
    named = AppliedEffect(RANDOM_DELAY.name, None, values)
    known = RANDOM_DELAY.parameters(state.setting.problem.model, None)
    library = {**state.setting.library, Candidate(named.name, None): known}
    fit = replace(state.best.fit, effects=(*effects[:at], named, *effects[at + 1 :]))
    behind = sum(len(effect.parameters) for effect in effects[: at + 1])
    widths = (*state.widths[:behind], lateness.width, *state.widths[behind:])
    correlation = state.correlation
    if correlation is not None:
        # It is found from what the others leave, and depends on none of them.
        correlation = np.insert(correlation, behind, 0.0, axis=0)
        correlation = np.insert(correlation, behind, 0.0, axis=1)
        correlation[behind, behind] = 1.0
    return replace(
        state,
        best=Scored(fit, state.best.everything),
        setting=replace(state.setting, library=library),
        widths=widths,
        correlation=correlation,
    )


def _before_as_logged(state: State, lateness: Lateness) -> State:
    """Return the state with the gap before as it is with commands as logged."""
    if state.residual is None:
        return state
    rows = lateness.problem.residuals([Hypothesis()])[0]
    recording = lateness.problem.layout.recording

    def size(some: tuple[int, ...]) -> float:
        return float(np.sqrt(np.mean(rows[np.isin(recording, some)] ** 2)))

    gap = replace(
        state.residual.gap,
        before_train=size(state.setting.train),
        before_heldout=size(state.setting.heldout),
    )
    return replace(state, residual=replace(state.residual, gap=gap))
