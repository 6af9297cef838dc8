"""One round of the search for another effect: shortlist, screen, fit, swap, take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.comparison import block_sums
from rlco.gap.search.discontinuous import best_values, better_start, is_discontinuous
from rlco.gap.search.fit import Fit, candidates_of, linearise
from rlco.gap.search.judge import NEAR_FLOOR, at_bounds, gain, is_worth_it
from rlco.gap.search.refine import (
    HINT,
    polished,
    ranked,
    refined,
    starts_beside,
    worst_alone,
)
from rlco.gap.search.screening import screen_effects, start_of
from rlco.gap.search.setting import Scored, Setting
from rlco.gap.search.state import Round, State
from rlco.physics.effects import AppliedEffect

CLEAN = 1.1  # ratio to the typical mean square of a joint that needs no effect
SCREENED_AGAIN = 24  # candidates of a screening under effects
FITTABLE = 0.015  # share of the mean square that two steps must remove
# As `judge.BETTER` if a parameter reached its bounds: all are in doubt.
WORTH_BOUNDS = 0.1


def shortlist(state: State) -> State:
    """Begin a round: list the candidates that may explain some of the residual."""
    subset = state.screening_setting()
    at = linearise(subset.library, state.best.effects, subset.whiten)
    return replace(state, round=Round(at, tuple(_worth_screening(state, at))))


def _worth_screening(state: State, at: Fit) -> list[Candidate]:
    """Return candidates that may explain something, in the library's order.

    An effect at a joint changes that joint more than any other. And an effect's change
    hardly depends on the other effects: candidates that explained nothing with one
    effect less explain nothing now.
    """
    setting, best = state.setting, state.best
    fresh = [c for c in setting.library if c not in best.names]
    if not best.effects:
        return fresh
    layout = setting.problem.layout
    near = np.isin(layout.recording, setting.train)
    sizes = block_sums(best.fit.residual**2, layout.channel[near])
    sizes /= np.bincount(layout.channel[near])
    clean = CLEAN * min(1.0, float(np.median(sizes)))
    done = {layout.channels[i] for i in np.flatnonzero(sizes < clean)}
    if setting.problem.noise_was_observed:
        # An encoder's offset may show more at another joint, and be small.
        done = set()
    found = [c for c in fresh if c.target not in done]
    screened = {one.candidate for one in state.screenings}
    hint = HINT / setting.parts
    informative = dict.fromkeys(
        one.candidate for one in ranked(state.screenings, at, hint)
    )
    again = set(list(informative)[:SCREENED_AGAIN])
    return [c for c in found if c in again or c not in screened]


def screen(state: State) -> State:
    """Simulate the change by a typical size of each listed candidate."""
    now, subset, best = _round(state), state.screening_setting(), state.best
    screenings = tuple(
        screen_effects(
            subset.library, now.candidates, best.effects, now.at.residual, subset.whiten
        )
    )
    known = {one.candidate for one in screenings}
    kept = tuple(one for one in state.screenings if one.candidate not in known)
    visible = state.visible
    if not best.effects:
        sizes = [float(np.mean(one.first**2)) for one in screenings]
        visible = sum(size > 1.0 for size in sizes) > 0.2 * len(sizes)
    return replace(
        state,
        screenings=kept + screenings,
        visible=visible,
        round=replace(now, screenings=screenings),
    )


def forward(state: State) -> State:
    """Fit the candidates that would explain most, each added to the best effects."""
    now, subset = _round(state), state.screening_setting()
    hint = HINT / subset.parts
    starts = starts_beside(subset.library, now.screenings, now.at, hint)
    if now.at.cost > NEAR_FLOOR**2:
        starts = _tried_values(subset, starts, now.at)
    most = (1.0 - FITTABLE / subset.parts) * now.at.cost
    state, options = refined(state, subset, starts, now.at, most)
    return replace(state, round=replace(now, options=tuple(options)))


def _tried_values(
    subset: Setting, starts: list[tuple[AppliedEffect, ...]], at: Fit
) -> list[tuple[AppliedEffect, ...]]:
    """Return starts, with the best of the values tried in one recording."""
    alone = worst_alone(subset, at.residual)
    jumping = [
        start
        for candidate in subset.library
        if is_discontinuous(subset, candidate)
        and candidate not in candidates_of(at.effects)
        for start in best_values(alone, at.effects, candidate)
    ]
    sizes = [other for one in starts for other in better_start(alone, one)]
    return jumping + starts + sizes


def swap(state: State) -> State:
    """Replace the other effects in the best options, and fit."""
    now, subset = _round(state), state.screening_setting()
    starts: list[tuple[AppliedEffect, ...]] = []
    for option in now.options[:2]:
        if len(option.effects) < 2:
            continue
        for out in option.effects[:-1]:
            state, others = _instead(state, subset, option, out)
            starts += others
    state, options = refined(state, subset, starts)
    return replace(state, round=replace(now, options=(*now.options, *options)))


def _instead(
    state: State, subset: Setting, option: Scored, out: AppliedEffect
) -> tuple[State, list[tuple[AppliedEffect, ...]]]:
    """Return starts with the best alternatives to one effect."""
    rest = tuple(effect for effect in option.effects if effect is not out)
    known = state.scores.get(frozenset(candidates_of(rest)))
    if known is None:
        state, fits = state.fit([rest])
        if not fits:
            return state, []
        known = fits[0]
    kept = known.effects
    at = linearise(subset.library, kept, subset.whiten)
    names = frozenset(candidates_of(kept))
    fresh = [one for one in _round(state).screenings if one.candidate not in names]
    starts = [
        kept + start_of(subset.library, one, at.residual)
        for one in ranked(fresh, at, HINT / subset.parts)[:3]
        if one.candidate != Candidate(out.name, out.target)
        and frozenset((*names, one.candidate)) not in state.scores
    ]
    return state, starts


def take(state: State) -> State:
    """End a round: take the best option that is clearly better, fitted to convergence.

    If there is none, other recordings may show what is missing: they are screened next,
    or the search has ended.
    """
    state, found = _picked(state, _round(state).options)
    state = replace(state, round=None)
    if found is not None:
        state, best = polished(state, found)
        return replace(state, best=best)
    setting, best = state.setting, state.best
    largest = setting.largest_residuals(best.fit.residual, len(state.screened))
    others = tuple(sorted(largest))
    if best.error < NEAR_FLOOR or others == state.screened:
        return replace(state, ended=True)
    return replace(state, screened=others, screenings=())


def _picked(state: State, options: tuple[Scored, ...]) -> tuple[State, Scored | None]:
    """Return the best option that is clearly better than the best so far."""
    setting, best = state.setting, state.best
    for one in sorted(options, key=lambda one: one.fit.cost):
        gained = gain(state, one, best)
        # A parameter at its bound explains nothing: another effect is likely.
        ran = at_bounds(setting.library, one.effects)
        ran = ran and not at_bounds(setting.library, best.effects)
        sure = is_worth_it(state, one, best) and (not ran or gained > WORTH_BOUNDS)
        row = {"effects": one.effects, "error": one.error, "gain": gained}
        state = state.noted(**row, taken=sure)
        if sure:
            return state, one
    return state, None


def _round(state: State) -> Round:
    if state.round is None:
        raise ValueError("no round is under way: begin one with `shortlist`")
    return state.round
