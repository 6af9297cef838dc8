"""Sensitivity to the model tolerance when effects change it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.logs.log import Array
from rlco.gap.search.fit import linearise
from rlco.gap.search.setting import (
    Weights,
    costless,
    in_noise,
    moved_by_tolerance,
)
from rlco.gap.search.state import State
from rlco.gap.search.whitening import Whitening
from rlco.physics.effects import AppliedEffect

GREW = 30.0  # ratio of squared sensitivities from which whitening is repeated
_OTHER = 0.3  # share of the guesses' squares that must change for them to be renewed
_PARALLEL = 1e-6  # part of a parameter's change that no other parameter does


def rewhiten(state: State) -> State:
    """Determine the tolerance's change anew, where effects make the robot sensitive.

    Any small difference decides when a motor that can hardly hold its arm drops it; a
    stronger motor hides the difference. All previous fits are then discarded, because
    their whitening was different.
    """
    setting, best = state.setting, state.best
    problem, prior = setting.problem, setting.prior
    scale = problem.noise[problem.layout.channel]
    screened = np.isin(problem.layout.recording, state.screened)
    _, moved = moved_by_tolerance(problem, best.effects, state.screened)
    if problem.calibration is not None:
        moved = _beyond_effects(state, moved, scale[screened])
    after = float(in_noise(moved, prior, scale[screened]).sum())
    calm = float(setting.calm[screened].sum())
    state = replace(state, sensitivity=after / calm if calm > 0.0 else 1.0)
    known = setting.weights.moved[:, screened]
    before = float(in_noise(known, prior, scale[screened]).sum())
    guessed = _guessed_anew(state)
    if not GREW * before < after < np.inf and guessed is setting.guessed:
        return state
    _, moved = moved_by_tolerance(problem, best.effects)
    if not np.isfinite(moved).all():
        return state
    weights = Weights.of(
        problem,
        setting.train,
        setting.heldout,
        moved,
        prior,
        setting.outliers,
        costless(guessed, setting.free),
    )
    setting = replace(setting, weights=weights, guessed=guessed)
    fresh = replace(state, setting=setting, scores={}, screenings=())
    nothing = linearise(fresh.setting.library, (), fresh.setting.whiten)
    fresh, _ = fresh.score([nothing])
    fresh, again = fresh.fit([best.effects])
    return replace(fresh, best=again[0]) if again else state


def _guessed_anew(state: State) -> Array:
    """Return `Setting.guessed` under the best effects, where these change it.

    Commands that arrive later change the motion later.
    """
    setting = state.setting
    if not len(setting.guessed):
        return setting.guessed
    found = setting.problem.by_guesses(Hypothesis(state.best.effects))
    if not len(found):
        return setting.guessed
    scale = setting.problem.noise[setting.problem.layout.channel]
    before, after = (
        np.sum((columns / scale) ** 2, axis=0) for columns in (setting.guessed, found)
    )
    changed = float(np.abs(after - before).sum()) > _OTHER * float(before.sum())
    return found if changed else setting.guessed


def _beyond_effects(state: State, moved: Array, scale: Array) -> Array:
    """Return the tolerance's change less what the best effects' parameters do, too.

    A calibration leaves open what moves nothing, such as all masses together with the
    torque's unit. That unit also scales the torque of a payload: so its mass is not
    known better than the unit, but the payload itself is no less certain.
    """
    setting, some = state.setting, state.screened

    def in_units(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        return setting.residuals(lists, some) / scale

    fitted = linearise(setting.library, state.best.effects, in_units)
    columns = fitted.jacobian.T
    if not np.isfinite(columns).all() or not np.isfinite(moved).all():
        return moved
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    basis, triangle = np.linalg.qr(columns / sizes)
    basis = basis[:, np.abs(np.diag(triangle)) > _PARALLEL]
    scaled = moved / scale
    return np.asarray((scaled - (scaled @ basis) @ basis.T) * scale)


def tolerance_beside(state: State) -> tuple[State, Whitening]:
    """Return `Weights.counted_once` with the tolerance's change under the best effects.

    Friction acts in units of the servo's stiffness: an error in stiffness changes the
    motion of a joint with friction, but not of one without.

    Returns:
        A state that contains it, and the whitening.
    """
    effects = state.best.effects
    if state.beside is not None and state.beside[0] is effects:
        return state, state.beside[1]
    whitening = _beside(state)
    return replace(state, beside=(effects, whitening)), whitening


def _beside(state: State) -> Whitening:
    setting, effects = state.setting, state.best.effects
    if not effects or not len(setting.prior):
        return setting.weights.counted_once
    problem, layout = setting.problem, setting.problem.layout
    _, moved = moved_by_tolerance(problem, effects, setting.train)
    if not np.isfinite(moved).all():
        return setting.weights.counted_once
    near = np.isin(layout.recording, setting.train)
    outliers = setting.outliers and setting.outliers.part(near)
    scale, prior = problem.noise[layout.channel][near], setting.prior
    if (costless := setting.costless()) is not None:
        moved, prior = costless.beside(moved, prior, near, -1)
    return Whitening.of(scale, moved, prior, -1, outliers)
