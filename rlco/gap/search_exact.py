"""A small effect that a spread of all numbers would explain too, but not more simply.

Numbers that are all a little off make up for one that is off by a little more. But
where one effect by itself leaves nothing but noise, and no more than all of them
together, they have nothing else to make up for: the model is exact but for that effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from rlco.gap.fit import Fit, candidates_of, linearise
from rlco.gap.probe import Probe, orthonormal
from rlco.gap.search import (
    BETTER,
    LARGEST,
    NEAR_FLOOR,
    at_bounds,
    first_look,
    polished,
    ranked,
    refined,
    starts_beside,
)
from rlco.gap.search_start import GREW, spread_beside, weightings
from rlco.gap.search_state import Scored, Search

AS_WELL = 1.0 + BETTER  # times what the spread leaves that one effect may leave
FEWER = 3  # directions that the spread takes: one effect for fewer is no simpler
TOLD = 0.1  # weight of a direction that recordings tell much better than the prior
EXACT = 1.1  # error over the noise floor where nothing but noise is left
ALL = 0.99  # part of what an effect explains that is as good as all of it
# Which numbers of the spread an effect changes, by the names of `rlco.gap.spread`.
_OWN = {
    "viscous_damping": ("damping",),
    "armature": ("armature",),
    "coulomb_friction": ("friction",),
    "link_inertia": ("mass", "inertia"),
    "payload": ("mass", "inertia"),
    "actuator_gain": ("gain",),
    "torque_limit": ("limit",),
}
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
    if search.heldout_error(search.best) < EXACT or len(effects) >= LARGEST:
        return search
    # On the brink the last digits of a simulation show, as if they were news.
    if search.sensitivity > GREW or not search.probes:
        return search
    spread = spread_beside(search, effects)
    if int((spread.shrink < TOLD).sum()) < FEWER:
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
    for one in refined(exact, look, starts, at, enough):
        if one.error > NEAR_FLOOR:
            continue
        one = polished(exact, one)
        gain = 1.0 - one.error / best.error
        simpler = one.error < EXACT and one.fit.cost < AS_WELL**2 * left
        if not simpler or at_bounds(exact, one) or _own_number_does(search, best, one):
            continue
        if gain > BETTER and exact.better(one, best):
            exact.best = one
            row = {"effects": one.effects, "error": one.error, "gain": gain}
            exact.trail.append({**row, "taken": True})
            return exact
    return search


def _own_number_does(search: Search, before: Scored, found: Scored) -> bool:
    """Return whether the numbers that an effect changes do as well within the spread.

    Args:
        search: The search with its spread.
        before: Without the effect.
        found: With it, as the last.
    """
    effect, names = found.effects[-1], search.problem.spread_names
    own = [f"{kind}:{effect.target}" for kind in _OWN.get(effect.name, ())]
    numbers = [names.index(name) for name in own if name in names]
    if not numbers:
        return False
    layout = search.problem.layout
    near = np.isin(layout.recording, search.train)
    rows = search.moved[numbers][:, near] / search.problem.noise[layout.channel][near]
    residual, most = before.fit.residual, search.prior[numbers]
    amounts = lsq_linear(rows.T, -residual, (-most, most)).x
    left = float(np.mean((residual + amounts @ rows) ** 2))
    return before.fit.cost - left > ALL * (before.fit.cost - found.fit.cost)


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
