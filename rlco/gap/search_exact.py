"""A small effect that a spread of all numbers would explain too, but not more simply.

Numbers that are all a little off make up for one that is off by a little more. But
where one effect by itself leaves nothing but noise, and no more than all of them
together, they have nothing else to make up for: the model is exact but for that effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlco.gap.fit import Fit, candidates_of, linearise
from rlco.gap.probe import Probe, orthonormal
from rlco.gap.search import (
    BETTER,
    CLEAN,
    NEAR_FLOOR,
    first_look,
    polished,
    ranked,
    refined,
    starts_beside,
)
from rlco.gap.search_start import GREW, moved_by_spread, weightings
from rlco.gap.search_state import Search
from rlco.gap.weighting import Weighting
from rlco.physics.effects import AppliedEffect

AS_WELL = 1.0 + BETTER  # times what the spread leaves that one effect may leave
FEWER = 3  # numbers of the spread, at least, in the place of which one effect comes
TOLD = 0.1  # weight of a direction that the recordings tell much better than the prior
HINT = 0.3  # part of what the spread explains that a first look must explain
HALF_WAY = 0.6  # part of it that two steps must explain


def with_exact_model(search: Search) -> Search:
    """Look for one more effect as if all other numbers of the model were right.

    Args:
        search: A finished search.

    Returns:
        A search without a spread that has found one more effect, or the search that
        was given, where no effect explains as much as a spread of all numbers.
    """
    if search.best is None or not len(search.prior):
        return search
    effects = search.best.effects
    if search.heldout_error(effects) < CLEAN:
        return search
    if effects:
        search.counted_once = _spread_beside(search, effects)
    spread = search.counted_once
    # On the brink the last digits of a simulation show, as if they were news.
    few = int((spread.shrink < TOLD).sum()) < FEWER
    if search.sensitivity > GREW or not search.probes or few:
        return search
    exact = _exact(search)
    nothing = exact.score([linearise(exact.library, (), exact.weigh)])
    best = next(iter(exact.fit([effects]) if effects else nothing), None)
    if best is None:
        return search
    left = float(np.mean(spread.beyond_spread(best.fit.residual) ** 2))
    explained = 1.0 - left / best.fit.cost
    look = first_look(exact)
    at = linearise(look.library, best.effects, look.weigh)
    telling = ranked(_as_exact(search, at), at, HINT * explained)
    starts = starts_beside(exact, telling, at)
    enough = (1.0 - HALF_WAY * explained) * at.cost
    for one in refined(exact, look, starts, at, enough) if starts else ():
        if one.error > NEAR_FLOOR:
            continue
        one = polished(exact, one)
        gain = 1.0 - one.error / best.error
        alone = one.error < CLEAN and one.fit.cost < AS_WELL**2 * left
        if alone and gain > BETTER and exact.better(one, best):
            exact.best = one
            row = {"effects": one.effects, "error": one.error, "gain": gain}
            exact.trail.append({**row, "taken": True})
            return exact
    return search


def _spread_beside(search: Search, effects: tuple[AppliedEffect, ...]) -> Weighting:
    """Return `Search.counted_once` with what the spread does beside effects.

    Friction is told in units of the servo's stiffness: a stiffness that is a little off
    changes what a joint with friction does, and nothing where there is none.
    """
    _, moved = moved_by_spread(search.problem, effects, search.train)
    if not np.isfinite(moved).all():
        return search.counted_once
    near = np.isin(search.problem.layout.recording, search.train)
    scale = search.problem.noise[search.problem.layout.channel][near]
    outliers = search.outliers and search.outliers.part(near)
    return Weighting.of(scale, moved, search.prior, -1, outliers)


def _exact(search: Search) -> Search:
    """Return a search that allows for no spread."""
    moved, prior = np.zeros((0, len(search.problem.layout.channel))), np.zeros(0)
    parts = search.problem, search.train, search.heldout
    trained, together, once = weightings(*parts, moved, prior, search.outliers)
    return replace(
        search,
        weighting=trained,
        together=together,
        counted_once=once,
        at_first=together,
        moved=moved,
        prior=prior,
        probes=[],
        scores={},
    )


def _as_exact(search: Search, at: Fit) -> list[Probe]:
    """Return the last first look at each effect beside a fit, as it was unweighed."""
    weighting = first_look(search).weighting
    names = candidates_of(at.effects)
    return [
        replace(
            one,
            columns=orthonormal(weighting.scaled_from(one.columns)),
            first=weighting.scaled_from(one.first),
        )
        for one in search.probes
        if one.candidate not in names
    ]
