"""Rivals: alternatives to a named effect that the data cannot distinguish."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.fit import candidates_of, fit, linearise
from rlco.gap.search.judge import at_bounds, is_rival
from rlco.gap.search.refine import ranked, refined
from rlco.gap.search.screening import screen_effects, start_of
from rlco.gap.search.setting import Scored
from rlco.gap.search.state import Rivals, State
from rlco.physics.effects import EFFECTS, AppliedEffect

HOPELESS = 10.0  # ratio to the best cost, after two steps, of a rejected fit
RIVALS = 5  # alternatives that are tried for each named effect


def rivals(state: State) -> State:
    """Try alternatives to each effect of the best set.

    Returns:
        A state with the rivals. Its best set is another if an alternative fits better,
        or equally well without a parameter at its bounds.
    """
    if not state.best.effects:
        return state
    state = _compared(state)
    within = _within_bounds(state)
    return state if within is state.best else _compared(replace(state, best=within))


def _compared(state: State) -> State:
    for _ in range(3):
        best, options = state.best, list[Scored]()
        for place in range(len(best.effects)):
            state, others = _others(state, place)
            options += others
        winner = min(options, key=lambda one: one.fit.cost, default=best)
        clearly = winner.fit.cost < best.fit.cost and state.setting.better(winner, best)
        if not clearly:
            break
        state = replace(state, best=winner)
    found = [_rivals_of(state, effect) for effect in state.best.effects]
    return replace(state, rivals=tuple(found))


def _rivals_of(state: State, effect: AppliedEffect) -> Rivals:
    """Return the alternatives to an effect that did equally well, and nearly so."""
    best, own = state.best, Candidate(effect.name, effect.target)
    rest = best.names - {own}
    as_good, evidence = [], {}
    for one in state.scores.values():
        other = one.names - rest
        if one.names == best.names or len(other) != 1 or not rest <= one.names:
            continue
        (candidate,) = other
        worse = one.error / best.error - 1.0
        evidence[f"{candidate.name} {candidate.target or ''}".strip()] = worse
        if is_rival(state.setting, best, one):
            as_good.append((one.fit.cost, candidate))
    as_good.sort(key=lambda pair: pair[0])
    near = dict(sorted(evidence.items(), key=lambda item: item[1])[:RIVALS])
    return Rivals(tuple(candidate for _, candidate in as_good), near)


def _within_bounds(state: State) -> Scored:
    """Return an equally good set without a parameter at its bounds, if there is one."""
    best, setting = state.best, state.setting
    if not at_bounds(setting.library, best.effects):
        return best
    likely = [
        one
        for one in state.scores.values()
        if 0 < len(one.effects) <= len(best.effects)
        and is_rival(setting, best, one)
        and not at_bounds(setting.library, one.effects)
    ]
    return min(likely, key=lambda one: one.fit.cost, default=best)


def _others(state: State, place: int) -> tuple[State, list[Scored]]:
    """Fit the most informative alternatives to one effect of the best set."""
    best, subset = state.best, state.screening_setting()
    out = best.effects[place]
    rest = tuple(effect for effect in best.effects if effect is not out)
    known = state.scores.get(frozenset(candidates_of(rest)))
    kept = (
        known.effects
        if known
        else fit(subset.library, [rest], subset.whiten)[0].effects
    )
    at = linearise(subset.library, kept, subset.whiten)
    names = frozenset(candidates_of(kept))
    fresh = [
        candidate
        for candidate in _likely(state, out)
        if frozenset((*names, candidate)) not in state.scores
    ]
    screened = {one.candidate for one in state.screenings}
    unscreened = [candidate for candidate in fresh if candidate not in screened]
    screenings = screen_effects(
        subset.library, unscreened, kept, at.residual, subset.whiten
    )
    state = replace(state, screenings=(*state.screenings, *screenings))
    once = [
        (*kept, effect)
        for candidate, effect in _once_as_good(state, out)
        if candidate in fresh
    ]
    starts: dict[Candidate, tuple[AppliedEffect, ...]] = {}
    for one in ranked([one for one in state.screenings if one.candidate in fresh], at):
        start = start_of(subset.library, one, at.residual)
        starts.setdefault(one.candidate, kept + start)
    (rows,) = subset.whiten([best.effects])
    most = HOPELESS * float(np.mean(rows**2))
    return refined(state, subset, once + list(starts.values())[:RIVALS], at, most)


def _likely(state: State, out: AppliedEffect) -> list[Candidate]:
    """Return likely alternatives: at the same target, or known to look alike."""
    return [
        candidate
        for candidate in state.setting.library
        if candidate not in state.best.names
        and (
            candidate.target == out.target
            or candidate.name in EFFECTS[out.name].confused_with
            or candidate.target is None
        )
    ]


def _once_as_good(
    state: State, out: AppliedEffect
) -> Iterator[tuple[Candidate, AppliedEffect]]:
    """Yield others that once did as well as an effect, with fewer of the named ones.

    A screening would rank some of them low.
    """
    own, names = Candidate(out.name, out.target), state.best.names
    for one in state.scores.values():
        for other, effect in zip(candidates_of(one.effects), one.effects, strict=True):
            beside = one.names - {other}
            before = state.scores.get(beside | {own})
            if other in names or not beside <= names - {own} or before is None:
                continue
            if is_rival(state.setting, before, one):
                yield other, effect
