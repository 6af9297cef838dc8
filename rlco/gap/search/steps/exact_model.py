"""Look for a small effect that the model tolerance would explain, but less simply.

Small changes of all parameters can replace a larger change of one. But if one effect
alone leaves nothing but noise, and no more residual than all of them together, there is
nothing else to explain: the model is exact except for that effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from rlco.gap.search.fit import Fit, candidates_of, linearise
from rlco.gap.search.judge import BETTER, LARGEST, NEAR_FLOOR, at_bounds
from rlco.gap.search.refine import polished, ranked, refined, starts_beside
from rlco.gap.search.screening import Screening, orthonormal
from rlco.gap.search.setting import Scored, Weights
from rlco.gap.search.state import State
from rlco.gap.search.steps.sensitivity import GREW, tolerance_beside
from rlco.physics.effects import EFFECTS

AS_WELL = 1.0 + BETTER  # ratio of the effect's residual to the tolerance's, at most
FEWER = 3  # directions used by the tolerance; one effect for fewer is no simpler
INFORMED = 0.1  # shrinkage of a direction that data determine better than the prior
EXACT = 1.1  # error over the noise floor where only noise remains
ALL = 0.99  # share of what an effect explains that is as good as all of it
HINT = 0.3  # share of what the tolerance explains that a screening must explain
HALF_WAY = 0.6  # share of it that two steps must explain


def exact_model(state: State) -> State:
    """Look for one more effect as if all other parameters of the model were exact.

    Args:
        state: Of a search that has added and dropped its effects.

    Returns:
        A state without tolerance that contains one more effect. Where no effect
        explains as much as the tolerance, the given state, with the tolerance's change
        added.
    """
    setting, effects = state.setting, state.best.effects
    if not len(setting.prior) or len(effects) >= LARGEST:
        return state
    if setting.problem.calibration is not None or setting.free is not None:
        return state  # it is known not to be exact
    if setting.heldout_error(state.best) < EXACT:
        return state
    # At the edge of stability, simulations amplify rounding errors.
    if state.sensitivity > GREW or not state.screenings:
        return state
    state, whitening = tolerance_beside(state)
    if int((whitening.shrink < INFORMED).sum()) < FEWER:
        return state
    exact = without_tolerance(state)
    if exact is None:
        return state
    residual_square = float(
        np.mean(whitening.beyond_tolerance(exact.best.fit.residual) ** 2)
    )
    exact, options = _one_more(
        state, exact, 1.0 - residual_square / exact.best.fit.cost
    )
    for one in options:
        if one.error > NEAR_FLOOR:
            continue
        exact, one = polished(exact, one)
        gain = 1.0 - one.error / exact.best.error
        simpler = one.error < EXACT and one.fit.cost < AS_WELL**2 * residual_square
        if not simpler or at_bounds(setting.library, one.effects):
            continue
        if _own_parameters_suffice(state, exact.best, one):
            continue
        if gain > BETTER and exact.setting.better(one, exact.best):
            exact = exact.noted(
                effects=one.effects, error=one.error, gain=gain, taken=True
            )
            return replace(exact, best=one)
    return state


def without_tolerance(state: State) -> State | None:
    """Return the state without tolerance, its best effects fitted anew."""
    setting, effects = state.setting, state.best.effects
    moved, prior = np.zeros((0, len(setting.problem.layout.channel))), np.zeros(0)
    weights = Weights.of(
        setting.problem,
        setting.train,
        setting.heldout,
        moved,
        prior,
        setting.outliers,
        setting.costless(),
    )
    setting = replace(setting, weights=weights, at_first=weights.together, prior=prior)
    exact = replace(state, setting=setting, screenings=(), scores={})
    exact, fits = exact.score([linearise(setting.library, (), setting.whiten)])
    if effects:
        exact, fits = exact.fit([effects])
    return replace(exact, best=fits[0]) if fits else None


def _one_more(
    state: State, exact: State, explained: float
) -> tuple[State, list[Scored]]:
    """Fit one more effect without tolerance.

    Args:
        state: With tolerance; its screenings are used.
        exact: Without it.
        explained: Share of the mean square that the tolerance explains.

    Returns:
        The state without tolerance, and the fits.
    """
    subset = exact.screening_setting()
    at = linearise(subset.library, exact.best.effects, subset.whiten)
    informative = ranked(screenings_without_tolerance(state, at), at, HINT * explained)
    starts = starts_beside(subset.library, informative, at)
    enough = (1.0 - HALF_WAY * explained) * at.cost
    return refined(exact, subset, starts, at, enough)


def _own_parameters_suffice(state: State, before: Scored, found: Scored) -> bool:
    """Return whether the tolerance of an effect's own parameters does as well.

    Args:
        state: With its tolerance.
        before: Without the effect.
        found: With it, as the last.
    """
    setting = state.setting
    problem, layout = setting.problem, setting.problem.layout
    effect, names = found.effects[-1], problem.tolerance_names
    own = [f"{kind}:{effect.target}" for kind in EFFECTS[effect.name].tolerances]
    indices = [names.index(name) for name in own if name in names]
    if not indices:
        return False
    near = np.isin(layout.recording, setting.train)
    scale = problem.noise[layout.channel][near]
    rows = setting.weights.moved[indices][:, near] / scale
    residual, most = before.fit.residual, setting.prior[indices]
    amounts = lsq_linear(rows.T, -residual, (-most, most)).x
    residual_square = float(np.mean((residual + amounts @ rows) ** 2))
    return before.fit.cost - residual_square > ALL * (before.fit.cost - found.fit.cost)


def screenings_without_tolerance(state: State, at: Fit) -> list[Screening]:
    """Return the last screening at each effect under a fit, without whitening."""
    whitening = state.screening_setting().weights.training
    names = candidates_of(at.effects)
    return [
        replace(
            one,
            columns=orthonormal(whitening.scaled_from(one.columns)),
            first=whitening.scaled_from(one.first),
        )
        for one in state.screenings
        if one.candidate not in names
    ]
