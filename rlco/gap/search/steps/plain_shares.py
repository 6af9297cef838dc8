"""What single effects explain by themselves, where a search could name none.

A tolerance of all parameters together may explain what one load explains alone, and
hide it. Whoever reads that nothing explains a gap should see what explains half of it.
"""

from __future__ import annotations

from dataclasses import replace

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.fit import fit, linearise
from rlco.gap.search.judge import kind, residual_share
from rlco.gap.search.refine import ranked
from rlco.gap.search.screening import start_of
from rlco.gap.search.state import State
from rlco.gap.search.steps.exact_model import (
    screenings_without_tolerance,
    without_tolerance,
)
from rlco.physics.effects import AppliedEffect

TRIED = 5
_STEPS = 3


def plain_shares(state: State) -> State:
    """Fit the single effects that explain most without any tolerance.

    Returns:
        A state with the share of the gap that each explains; the given one where
        something is named, or nothing is unexplained.
    """
    if kind(state) != "unexplained" or not state.screenings:
        return state
    bare = without_tolerance(replace(state, best=state.none))
    if bare is None:
        return state
    subset = bare.screening_setting()
    at = linearise(subset.library, (), subset.whiten)
    starts: dict[Candidate, tuple[AppliedEffect, ...]] = {}
    for one in ranked(screenings_without_tolerance(state, at), at):
        start = start_of(subset.library, one, at.residual)
        starts.setdefault(one.candidate, start)
    # What the search chose among all was not enough for a name, and may be the nearest.
    chosen = {Candidate(e.name, e.target): (e,) for e in state.best.effects}
    likely = list((chosen | dict(list(starts.items())[:TRIED])).values())
    fits = fit(subset.library, likely, subset.whiten, steps=_STEPS)
    none, plain = bare.none, dict[Candidate, float]()
    for scored in bare.setting.score([f for f in fits if f.cost < at.cost]):
        (name,) = scored.names
        plain[name] = 1.0 - residual_share(none, scored)
    return replace(state, plain=plain)
