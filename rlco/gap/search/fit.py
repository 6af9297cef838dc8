"""Fit the parameters of many hypotheses at once, within bounds.

Damped Gauss-Newton steps. Simulations dominate the cost. The Jacobian is taken once by
finite differences and updated after each step (Broyden, Mathematics of Computation
1965, equation 4.5). After a step that fails it is taken anew; a step that fails right
after that is the last. All hypotheses step together, so that their simulations form one
batch for the threads.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from rlco.gap.compare.problem import Candidate, Problem
from rlco.gap.logs.log import Array
from rlco.physics.effects import EFFECTS, AppliedEffect, Parameter
from rlco.physics.effects.friction import COULOMB_FRICTION

# Whitened residuals of each list of effects, (lists, N).
Whiten = Callable[[Sequence[tuple[AppliedEffect, ...]]], Array]
# The parameters of each effect at each target that may be part of a hypothesis.
Library = Mapping[Candidate, tuple[Parameter, ...]]
_SHORTER = 0.35  # fraction of a Gauss-Newton step that is tried after a failed one
_JUMPS = (-4, -2, -1, 1, 2, 4)  # trial steps of parameters with a resolution
_LEAST = 1e-3  # of the usual size; shorter steps do not update the Jacobian
_OVER_JUMPS = 0.2  # of the usual size: a difference that contacts cannot dominate


@dataclass(frozen=True)
class Fit:
    """Effects with their best-fitting parameters.

    Attributes:
        effects: The effects.
        cost: Mean square of the whitened residual; 1 at the noise floor.
        jacobian: Approximate change of the whitened residual per unit of each
            parameter, (parameters, N); `linearise` makes it exact.
        residual: The whitened residual, (N,).
    """

    effects: tuple[AppliedEffect, ...]
    cost: float
    jacobian: Array
    residual: Array


def library_of(problem: Problem, exclude: Collection[str] = ()) -> Library:
    """Return all candidates, with the parameters of each.

    Args:
        problem: The robot and its log.
        exclude: Names of effects to leave out.
    """
    library: dict[Candidate, tuple[Parameter, ...]] = {
        candidate: EFFECTS[candidate.name].parameters(problem.model, candidate.target)
        for candidate in problem.candidates()
        if candidate.name not in exclude
    }
    if problem.noise_was_observed:
        # What was calibrated may also have become less.
        library |= {
            candidate: (_may_fall(first), *others)
            for candidate, (first, *others) in library.items()
            if candidate.name == COULOMB_FRICTION.name
        }
    for candidate, starts in problem.usual_sizes().items():
        if candidate in library:
            first, *others = library[candidate]
            near = tuple(s for s in starts if first.low < s < first.high)
            if near:
                library[candidate] = (replace(first, starts=near), *others)
    if problem.has_outliers:
        library = {c: tuple(map(_over_jumps, known)) for c, known in library.items()}
    return library


def _over_jumps(parameter: Parameter) -> Parameter:
    """Return a parameter with a wide step for its derivative.

    Where a contact is made or missed, a residual jumps by an amount that does not
    depend on the step. Divided by a short one it hides the change that is sought, and
    every Gauss-Newton step is far too short. What has no effect until a limit is
    reached may change by little at a time, and keeps its step.
    """
    if parameter.step or not parameter.scales:
        return parameter
    return replace(parameter, step=_OVER_JUMPS * usual_size(parameter))


def _may_fall(friction: Parameter) -> Parameter:
    """Return a friction that may also be less than what a model has."""
    present = 0.0 if friction.present is None else friction.present.value
    starts = (*friction.starts, -0.4 * present)
    return replace(friction, low=-0.95 * present, starts=starts)


def with_values(
    library: Library, candidates: Sequence[Candidate], values: Array
) -> tuple[AppliedEffect, ...]:
    """Return effects with parameter values taken from one row of all their values."""
    effects, at = [], 0
    for candidate in candidates:
        known = library[candidate]
        parameters = {p.name: float(values[at + i]) for i, p in enumerate(known)}
        effects.append(AppliedEffect(candidate.name, candidate.target, parameters))
        at += len(known)
    return tuple(effects)


def candidates_of(effects: Sequence[AppliedEffect]) -> tuple[Candidate, ...]:
    """Return the candidates of effects, without parameter values."""
    return tuple(Candidate(effect.name, effect.target) for effect in effects)


def usual_size(parameter: Parameter) -> float:
    """Return a parameter's usual size; limits may have bounds far away."""
    away = parameter.neutral if parameter.scales else 0.0
    usual = max(abs(start - away) for start in parameter.starts)
    return usual or 0.1 * (parameter.high - parameter.low)


class _Running:
    """One hypothesis during its fit."""

    def __init__(self, library: Library, effects: Sequence[AppliedEffect]) -> None:
        self.library = library
        self.candidates = candidates_of(effects)
        known = [p for c in self.candidates for p in library[c]]
        self.low = np.array([p.low for p in known])
        self.high = np.array([p.high for p in known])
        self.size = np.array([usual_size(p) for p in known])
        self.resolution = np.array([p.resolution for p in known])
        self.step = np.array([p.step for p in known])
        values = [v for effect in effects for v in effect.parameters.values()]
        first = np.array(values, dtype=float)
        self.values: Array = np.clip(first, self.low, self.high)
        self.residual: Array = np.zeros(0)
        self.cost = np.inf
        self.jacobian: Array = np.zeros((0, 0))
        self.done = False
        # Whether the Jacobian was taken here, and whether it is still accurate.
        self.here, self.good = False, False

    def effects(self, values: Array) -> tuple[AppliedEffect, ...]:
        return with_values(self.library, self.candidates, values)

    def differences(self) -> Array:
        """Steps of the forward differences, towards the inside of the bounds."""
        step = 0.02 * np.maximum(self.size * 0.25, np.abs(self.values) * 0.5)
        step = np.minimum(step, 0.25 * (self.high - self.low))
        step = np.where(self.step > 0.0, self.step, step)
        return np.where(self.values + step > self.high, -step, step)

    def gauss_newton(self) -> Array:
        """Return the Gauss-Newton step, (parameters,)."""
        unit = self.size
        scaled = self.jacobian * unit[:, None]
        # Slight damping (Marquardt 1963): redundant parameters share the step.
        ridge = np.maximum(1e-3 * np.linalg.norm(scaled, axis=1), 1e-12)
        rows = np.concatenate([scaled.T, np.diag(ridge)])
        goal = np.concatenate([-self.residual, np.zeros(len(unit))])
        _, triangle = np.linalg.qr(np.column_stack([rows, goal]))
        bounds = (self.low - self.values) / unit, (self.high - self.values) / unit
        bounds = (np.minimum(bounds[0], -1e-9), np.maximum(bounds[1], 1e-9))
        step: Array = lsq_linear(triangle[:, :-1], triangle[:, -1], bounds).x * unit
        return step

    def trials(self) -> list[Array]:
        """Return values to try: a whole step, and jumps of those with a resolution."""
        found = [self.values + self.gauss_newton()]
        for i in np.flatnonzero(self.resolution):
            unit = self.resolution[i] * np.eye(len(self.values))[i]
            found += [self.values + jump * unit for jump in _JUMPS]
        return [np.clip(values, self.low, self.high) for values in found]

    def take(self, values: Array, residual: Array, correct: bool) -> bool:
        """Accept values if they fit better."""
        cost = _cost(residual)
        if not cost < self.cost:
            return False
        step = (values - self.values) / self.size
        length = float(step @ step)
        if correct and length > _LEAST**2:
            unexplained = residual - self.residual - (step * self.size) @ self.jacobian
            correction = np.outer(step / self.size, unexplained) / length
            self.jacobian = np.asarray(self.jacobian + correction)
        self.here = False
        self.cost, self.residual, self.values = cost, residual, values
        return True


def fit(
    library: Library,
    starts: Sequence[Sequence[AppliedEffect]],
    whiten: Whiten,
    *,
    steps: int = 6,
    tolerance: float = 2e-3,
    near: Fit | None = None,
) -> list[Fit]:
    """Return the best fit from each start, in the order of the starts.

    Args:
        library: Parameters of each candidate, for bounds.
        starts: Effects with their initial parameters.
        whiten: Whitened residuals of many lists of effects, (lists, N).
        steps: At most this many Gauss-Newton steps.
        tolerance: Stop when a step lowers the cost by less than this fraction.
        near: A fit of the same recordings with the first effects of each start, whose
            Jacobian is accurate enough to begin with.
    """
    running = [_Running(library, effects) for effects in starts]
    if not running:
        return []
    for one, residual in zip(
        running, whiten([one.effects(one.values) for one in running]), strict=True
    ):
        one.residual, one.cost = residual, _cost(residual)
        one.done = not np.isfinite(one.cost)
    if near is not None:
        _differentiate(running, whiten, near.jacobian)
    for _ in range(steps):
        moving = [one for one in running if not one.done]
        if not moving:
            break
        _differentiate([one for one in moving if not one.good], whiten)
        _step(moving, whiten, tolerance)
    return [
        Fit(one.effects(one.values), one.cost, one.jacobian, one.residual)
        for one in running
    ]


def linearise(
    library: Library, effects: Sequence[AppliedEffect], whiten: Whiten
) -> Fit:
    """Return a list of effects as a fit, with an exact Jacobian."""
    one = _Running(library, effects)
    one.residual = whiten([tuple(effects)])[0]
    if effects:
        _differentiate([one], whiten)
    else:
        one.jacobian = np.zeros((0, len(one.residual)))
    return Fit(tuple(effects), _cost(one.residual), one.jacobian, one.residual)


def _cost(residual: Array) -> float:
    return float(np.mean(residual**2)) if np.isfinite(residual).all() else np.inf


def _differentiate(
    moving: list[_Running], whiten: Whiten, known: Array | None = None
) -> None:
    """Take differences of all parameters, or only of those beyond the known ones."""
    lists, owners = [], []
    for one in moving:
        if one.done:
            continue
        steps = one.differences()
        one.jacobian = np.zeros((len(steps), len(one.residual)))
        first = 0 if known is None else len(known)
        if known is not None:
            one.jacobian[:first] = known
        for i in range(first, len(steps)):
            if one.resolution[i]:
                continue  # discontinuous parameters have no gradient
            values = one.values.copy()
            values[i] += steps[i]
            lists.append(one.effects(values))
            owners.append((one, i, steps[i]))
        one.good, one.here = True, first == 0
    if not lists:
        return
    for (one, i, step), residual in zip(owners, whiten(lists), strict=True):
        if np.isfinite(residual).all():
            one.jacobian[i] = (residual - one.residual) / step


def _step(moving: list[_Running], whiten: Whiten, tolerance: float) -> None:
    before = [one.cost for one in moving]
    here = [one.here for one in moving]
    trials = [(one, one.trials()) for one in moving]
    tried = _try(trials, whiten)
    shorter = [
        (one, [one.values + _SHORTER * (whole - one.values)])
        for (one, (whole, *_)), taken in zip(trials, tried, strict=True)
        if one.here and not taken
    ]
    _try(shorter, whiten)
    for one, cost, exact in zip(moving, before, here, strict=True):
        if cost - one.cost > tolerance * max(one.cost, 1e-12):
            continue
        one.good = False
        one.done = exact


def _try(trials: list[tuple[_Running, list[Array]]], whiten: Whiten) -> list[bool]:
    """Simulate values to try, a full step first; return which hypotheses moved."""
    pairs = [(one, values) for one, found in trials for values in found]
    if not pairs:
        return []
    rows = iter(whiten([one.effects(values) for one, values in pairs]))
    moved = []
    for one, found in trials:
        results = [(values, next(rows)) for values in found]
        best = min(range(len(found)), key=lambda i: _cost(results[i][1]))
        moved.append(one.take(*results[best], correct=best == 0))
    return moved
