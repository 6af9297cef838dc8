"""Narrow many candidates down to a few good fits."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from rlco.gap.compare.problem import Candidate
from rlco.gap.logs.log import Array
from rlco.gap.search.discontinuous import other_values
from rlco.gap.search.fit import Fit, Library, candidates_of, fit
from rlco.gap.search.judge import NEAR_FLOOR
from rlco.gap.search.screening import Screening, explained, start_of
from rlco.gap.search.setting import Scored, Setting
from rlco.gap.search.state import State
from rlco.physics.effects import AppliedEffect

FITTED = 6  # candidates that a forward step fits
HINT = 0.015  # share of the mean square that a screening must explain


def ranked(
    screenings: Iterable[Screening], at: Fit, hint: float = HINT
) -> list[Screening]:
    """Return the screenings that would improve a fit, the most informative first.

    Args:
        screenings: Changes that effects would cause.
        at: The fit to improve, of the same recordings.
        hint: Share of the mean square that a screening must explain.
    """
    beside = _beside(at)
    rest_of_residual = at.residual - (at.residual @ beside.T) @ beside
    gains = [
        (explained(one, rest_of_residual, beside), i, one)
        for i, one in enumerate(screenings)
    ]
    # A fit explains more than a screening, but not many times as much.
    least = hint * float(np.mean(at.residual**2))
    return [one for gain, _, one in sorted(gains, key=lambda g: -g[0]) if gain > least]


def _beside(at: Fit) -> Array:
    """Return the directions that the parameters of present effects explain already."""
    if not at.effects:
        return np.zeros((0, len(at.residual)))
    basis, _ = np.linalg.qr(at.jacobian.T)
    return np.ascontiguousarray(basis.T)


def starts_beside(
    library: Library, screenings: Iterable[Screening], at: Fit, hint: float = HINT
) -> list[tuple[AppliedEffect, ...]]:
    """Return starts of the most informative candidates, added to present effects."""
    starts, counts = [], dict[Candidate, int]()
    for one in ranked(screenings, at, hint):
        count = counts.get(one.candidate, 0)
        if count == 2 or (count == 0 and len(counts) == FITTED):
            continue
        counts[one.candidate] = count + 1
        starts.append(at.effects + start_of(library, one, at.residual))
    return starts


def refined(
    state: State,
    subset: Setting,
    starts: list[tuple[AppliedEffect, ...]],
    at: Fit | None = None,
    most: float = np.inf,
) -> tuple[State, list[Scored]]:
    """Fit briefly from each start to some recordings, and continue with the best.

    Args:
        state: The state of the search.
        subset: Its setting with fewer recordings, for the first steps.
        starts: Effects with their initial parameters.
        at: A fit of the screening's recordings with the first effects of each start.
        most: Cost of the first steps above which a fit is abandoned.

    Returns:
        A state that contains the fits, and these fits.
    """
    rough = fit(subset.library, starts, subset.whiten, steps=2, near=at)
    best: dict[frozenset[Candidate], Fit] = {}
    for one in sorted(rough, key=lambda one: one.cost):
        best.setdefault(frozenset(candidates_of(one.effects)), one)
    ranking = list(best.values())
    near = [one for one in ranking if one.cost < min(2.0 * ranking[0].cost, most)][:4]
    return state.fit([one.effects for one in near], steps=5)


def polished(state: State, found: Scored) -> tuple[State, Scored]:
    """Fit until convergence: an unfinished fit's residual resembles another effect."""
    setting, starts = state.setting, [found.effects]
    if found.error > NEAR_FLOOR:
        alone = worst_alone(setting, found.fit.residual)
        starts += other_values(alone, found.effects)
    fits = fit(setting.library, starts, setting.whiten, steps=12, tolerance=1e-4)
    state, scored = state.score(sorted(fits, key=lambda one: one.cost)[:1])
    return state, next(iter(scored), found)


def worst_alone(subset: Setting, residual: Array) -> Setting:
    """Return a setting with only the recording that has the largest residual.

    Args:
        subset: A setting with several.
        residual: Whitened, of its training recordings, (N,).
    """
    return subset.restricted_to(subset.largest_residuals(residual, 1))
