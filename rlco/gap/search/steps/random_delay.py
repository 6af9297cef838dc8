"""Name how late commands arrive, once the time of each is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.logs.log import Array
from rlco.gap.search.judge import NAMED, kind
from rlco.gap.search.lateness import Lateness
from rlco.gap.search.setting import Scored
from rlco.gap.search.state import State
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.command import COMMAND_DELAY, RANDOM_DELAY

_DRAWS = 20_000  # of delays, to know how long commands wait for others
_ROUNDS = 12
_LATE = 0.3  # a mean of fewer spreads is none: commands would come early as often


def random_delay(state: State) -> State:
    """Return a state that names `random_delay` for its constant delay.

    Where no delay is named, commands took effect early as often as late, which is a
    matter of the log's times and not of the robot.

    Args:
        state: After the steps `intervals` and `residual`.
    """
    lateness = state.lateness
    if lateness is None:
        return state
    state = _before_as_logged(state, lateness)
    effects = state.best.effects
    place = {effect.name: index for index, effect in enumerate(effects)}
    at = place.get(COMMAND_DELAY.name)
    if at is None or kind(state) not in NAMED:
        return state
    mean = float(effects[at].values[0])
    if mean < _LATE * lateness.spread:
        return state
    logs = [np.asarray(one.time) for one in lateness.problem.log.recordings]
    mean, spread = before_waiting(logs, mean, lateness.spread)
    values = {"mean": mean, "spread": spread}
    named = AppliedEffect(RANDOM_DELAY.name, None, values)
    known = RANDOM_DELAY.parameters(state.setting.problem.model, None)
    library = {**state.setting.library, Candidate(named.name, None): known}
    fit = replace(state.best.fit, effects=(*effects[:at], named, *effects[at + 1 :]))
    behind = sum(len(effect.parameters) for effect in effects[: at + 1])
    width = lateness.width * spread / lateness.spread
    widths = (*state.widths[:behind], width, *state.widths[behind:])
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


def before_waiting(
    sent: Sequence[Array], mean: float, spread: float
) -> tuple[float, float]:
    """Return the distribution of delays of which commands took effect so late.

    A command that overtakes none waits for the one before it, so that commands take
    effect later than they arrive. `random_delay` is what they arrive by.

    Args:
        sent: When commands are sent, of each recording, (rows,) [s].
        mean: Of the times by which they took effect late [s].
        spread: Their standard deviation [s].

    Returns:
        Mean and standard deviation of a gamma distribution [s].

    Example:
        >>> rarely = [np.arange(0.0, 100.0, 1.0)]  # none catches up with another
        >>> mean, spread = before_waiting(rarely, 0.05, 0.02)
        >>> round(mean, 3), round(spread, 3)
        (0.05, 0.02)
    """
    from scipy.special import gammaincinv  # takes a while to import

    rows = sum(map(len, sent))
    times = [*sent] * max(1, -(-_DRAWS // rows))
    random = np.random.default_rng(0)
    shares = [random.uniform(size=len(one)) for one in times]
    drawn_mean, drawn_spread = mean, spread
    for _ in range(_ROUNDS):
        shape = (drawn_mean / drawn_spread) ** 2
        scale = drawn_spread**2 / drawn_mean
        late = np.concatenate(
            [
                np.maximum.accumulate(one + gammaincinv(shape, share) * scale) - one
                for one, share in zip(times, shares, strict=True)
            ]
        )
        drawn_mean = max(drawn_mean + mean - float(late.mean()), 0.1 * mean)
        drawn_spread *= spread / float(late.std())
    return drawn_mean, drawn_spread


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
