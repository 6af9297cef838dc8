"""Interpret the fits of a search: whether one suffices, ties with another, or is named.

Nothing here fits or simulates.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.fit import Library, usual_size
from rlco.gap.search.setting import Scored, Setting
from rlco.gap.search.state import State
from rlco.physics.effects import AppliedEffect, Parameter

LARGEST = 4  # maximum number of effects
NEAR_FLOOR = 1.3  # error over the noise floor above which something is missing
LOUD = 3.0  # ratio to the noise floor that the tolerance does not explain either
BETTER = 0.03  # share of the held-out error that an effect must remove
PLAIN = 0.01  # the same of one channel, where the noise was observed before
MUCH = 0.3  # the same of all, beyond which a few seconds that differ may decide there
ENOUGH = 0.5  # share of the gap that effects must explain to be named
QUIET = ("no_gap", "no_improvement", "not_identifiable")
NAMED = ("named", "ambiguous")


def at_bounds(library: Library, effects: Sequence[AppliedEffect]) -> bool:
    """Return whether a parameter reached its bound: another effect is then likely."""
    return bool(reached_bounds(library, effects))


def reached_bounds(
    library: Library, effects: Sequence[AppliedEffect]
) -> list[tuple[AppliedEffect, Parameter]]:
    """Return the parameters that reached the largest or smallest value searched."""
    reached = []
    for effect in effects:
        known = library[Candidate(effect.name, effect.target)]
        for parameter, value in zip(known, effect.values, strict=True):
            # A torque limit may be anything up to a hundred times what is there.
            near = 1e-3 * min(parameter.high - parameter.low, usual_size(parameter))
            away = abs(value - parameter.neutral) > near
            low, high = value - parameter.low < near, parameter.high - value < near
            if away and (low or high):
                reached.append((effect, parameter))
    return reached


def is_rival(setting: Setting, best: Scored, one: Scored) -> bool:
    """Return whether another set explains the data equally well, within uncertainty.

    If both leave more than noise, neither is true, and a small difference between them
    is less significant.
    """
    near = one.error < 1.03 * best.error and best.error > NEAR_FLOOR
    return near or not setting.better(best, one)


def residual_share(none: Scored, best: Scored) -> float:
    """Return the share of the gap above the noise that a set of effects leaves."""
    before = max(float(np.mean(none.everything**2)) - 1.0, 1e-9)
    after = max(float(np.mean(best.everything**2)) - 1.0, 0.0)
    return min(after / before, 1.0)


def gain(state: State, one: Scored, other: Scored) -> float:
    """Return the share of the held-out error that a set of effects removes.

    Where the noise was observed in recordings made before, each channel is taken by
    itself, and the one that gains most counts. But of those in which `other` explains
    something already, only where `one` removes more than the comparison may get wrong
    of that.

    Args:
        state: Of the search.
        one: The set.
        other: A set with fewer effects.
    """
    setting = state.setting
    if not setting.problem.noise_was_observed:
        return 1.0 - one.error / other.error
    none, before, after = (
        setting.heldout_squares(rows.everything) for rows in (state.none, other, one)
    )
    plain = before - after >= setting.problem.inexact * (none - before)
    # A channel without any residual gains nothing.
    ratio = np.divide(after, before, out=np.ones_like(after), where=before > 0.0)
    return float(np.max(np.where(plain, 1.0 - np.sqrt(ratio), 0.0)))


def is_worth_it(state: State, one: Scored, other: Scored) -> bool:
    """Return whether a set of effects is worth more than one with fewer.

    What a model lacks is not known of motion that was not recorded before. A few
    seconds of such motion do not decide by themselves, unless the effect explains much.
    """
    gained, setting = gain(state, one, other), state.setting
    if not setting.problem.noise_was_observed:
        return gained > BETTER and setting.better(one, other)
    if gained > PLAIN and 1.0 - one.error / other.error > MUCH:
        return setting.better(one, other)
    return gained > PLAIN and setting.better_by_both(one, other)


def kind(state: State) -> str:
    """Return the verdict of a state, one of those of `Verdict.verdict`."""
    best, none = state.best, state.none
    if best.effects and _holds(state):
        ambiguous = any(rivals.as_good for rivals in state.rivals)
        return "ambiguous" if ambiguous else "named"
    if best.effects:
        return "unexplained" if none.error > NEAR_FLOOR else "no_gap"
    # A gap in the fitted recordings alone affects the others through the tolerance.
    heldout = state.setting.heldout_error(none)
    if none.error > NEAR_FLOOR and heldout > NEAR_FLOOR:
        return "unexplained"
    if not state.visible:
        return "not_identifiable"
    others = [one for one in state.scores.values() if one.effects]
    trained = min((one.fit.cost for one in others), default=np.inf)
    better = trained < (1.0 - BETTER) ** 2 * float(np.mean(none.fit.residual**2))
    return "no_improvement" if better else "no_gap"


def found(state: State) -> Scored:
    """Return the set of effects that a state names; empty if it names nothing."""
    return state.best if kind(state) in NAMED else state.none


def is_noise(state: State) -> bool:
    """Return whether the remaining gap is within noise and model tolerance."""
    one = found(state)
    near = one.error < NEAR_FLOOR and state.setting.heldout_error(one) < NEAR_FLOOR
    return near or kind(state) in QUIET


def _holds(state: State) -> bool:
    """Return whether effects explain most of the gap, and help without tolerance."""
    best, none, setting = state.best, state.none, state.setting
    if residual_share(none, best) > 1.0 - ENOUGH and best.error > NEAR_FLOOR:
        return False
    if at_bounds(setting.library, best.effects):
        return False
    if not setting.problem.noise_was_observed:
        before, after = setting.heldout_error(none), setting.heldout_error(best)
        return after < (1.0 - BETTER) * before
    together = setting.weights.together
    whole, rest = (
        setting.heldout_squares(together.scaled_from(one.everything))
        for one in (none, best)
    )
    return bool((rest < (1.0 - PLAIN) ** 2 * whole).any())
