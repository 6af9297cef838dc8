"""Fit the numbers that are always a little wrong, under their priors (MAP).

Damped Gauss-Newton steps on the residual in units of the noise and, beside it, each
number's distance from its prior. Links have ten numbers each, most combinations of
which move nothing: for rollouts, which are dear, the combinations that matter are found
first by inverse dynamics along the measured motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from rlco.gap.calibrate.numbers import (
    Calibratable,
    Number,
    effects_of,
    usual_numbers,
)
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.torque.inverse_dynamics import inverse_dynamics
from rlco.gap.compare.torque.smooth_motion import smooth_motion
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import correlation_length, seconds_of
from rlco.gap.search.whitening import often
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import apply_to_spec
from rlco.physics.effects.link_parameters import LINK_PARAMETERS
from rlco.physics.effects.targets import actuator_of

STEPS = 12
_ENOUGH = 0.01  # part of the cost that a step must save for another one
_NEARLY = 0.1  # the same of a stage before the last
_SHORT = 0.4  # length of first rollouts [s]
_DIFFERENCE = 0.05  # finite difference, in standard deviations of the prior
_SHORTER = (1.0, 0.4, 0.15)  # parts of a step that are tried
_PART = 0.1  # of a channel's mean square that a second of it has at the least
_FIRST = 20.0  # seconds of recordings that the first steps fit
# Root mean square, in noise, below which a combination of link numbers is left out.
_SEEN = 0.15
_SMOOTH = 0.3  # [s]
# Inverse dynamics cannot know the forces of contacts and of friction at rest.
_UNCONSTRAINED = (
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT
)


@dataclass(frozen=True)
class Calibration:
    """Numbers of a model as fitted.

    Attributes:
        numbers: The numbers, N of them.
        amounts: How far each is from the model's, in deviations of its prior, (N,).
        basis: Orthonormal combinations of numbers that were fitted, (N, K).
        normal: Squared derivatives of the residual by these, of rows in units of what
            the fit leaves of their channel, as if all rows were independent, (K, K).
        length: How many rows count as one.
        rows: How many there were.
        cost_before: Mean square in units of the noise of the model as it is.
        cost: The same after.
    """

    numbers: tuple[Number, ...]
    amounts: Array
    basis: Array
    normal: Array
    length: float
    rows: int
    cost_before: float
    cost: float

    @property
    def covariance(self) -> Array:
        """Covariance of the amounts, (N, N).

        Combinations that were not fitted, since they show nowhere, keep their prior.
        """
        unseen = np.eye(len(self.amounts)) - self.basis @ self.basis.T
        return np.asarray(self._inverse(self.normal / self.length, 1.0) + unseen)

    @property
    def deviation(self) -> Array:
        """Standard deviation of each amount, (N,)."""
        return np.sqrt(np.diag(self.covariance))

    def covariance_per_row(self) -> Array:
        """Return the covariance for a search that counts each row, (N, N).

        The prior counts as often as there, see `rlco.gap.search.whitening`.
        """
        return self._inverse(self.normal, often(self.rows))

    def _inverse(self, normal: Array, prior: float) -> Array:
        inverse = np.linalg.inv(normal + prior * np.eye(len(normal)))
        return np.asarray(self.basis @ inverse @ self.basis.T)


def calibrate(
    problem: Calibratable,
    recordings: Sequence[int] | None = None,
    on_step: Callable[[int], None] | None = None,
    steps: int = STEPS,
) -> Calibration:
    """Fit a model's usual numbers to some recordings, under their priors.

    Args:
        problem: The model and its log.
        recordings: Which are fitted; None for all.
        on_step: Called after each step with its number.
        steps: At most this many of each stage.
    """
    numbers = tuple(usual_numbers(problem))
    basis = _directions(problem, numbers)
    some = tuple(recordings or range(len(problem.log.recordings)))
    first = _first(problem, some)
    fit = _Fit(problem, numbers, basis, first)
    before, taken = fit.cost, 0
    for one, fitted in _stages(problem, first, some):
        fit = _Fit(one, numbers, basis, fitted, fit.amounts)
        enough = _ENOUGH if one is problem else _NEARLY
        for _ in range(steps):
            moved = fit.step()
            if on_step is not None:
                on_step(taken)
            taken += 1
            if moved <= enough:
                break
    return Calibration(
        numbers,
        basis @ fit.amounts,
        basis,
        fit.normal(),
        fit.length(),
        len(fit.residual),
        before,
        fit.cost,
    )


def _stages(
    problem: Calibratable, first: tuple[int, ...], some: tuple[int, ...]
) -> list[tuple[Calibratable, tuple[int, ...]]]:
    """Return what is fitted one after the other, each with which recordings.

    Where an arm that is wrong everywhere reaches its limits, it soon is somewhere else,
    and derivatives along whole recordings lead nowhere. So short rollouts from measured
    states come first (multiple shooting; Bock and Plitt 1984).
    """
    if not isinstance(problem, ArmRollouts) or problem.horizon is not None:
        return [(problem, some)]
    short = ArmRollouts(
        problem.spec,
        problem.log,
        problem.noise,
        horizon=_SHORT,
        threads=problem.threads,
    )
    return [(short, first), (problem, some)]


def _first(problem: Calibratable, some: tuple[int, ...]) -> tuple[int, ...]:
    """Return enough of the recordings for first steps, evenly spread."""
    if isinstance(problem, TorqueLog):
        return some
    seconds = sum(problem.log.recordings[i].seconds for i in some)
    every = max(1, int(seconds / _FIRST))
    return some[::every]


def _directions(problem: Calibratable, numbers: Sequence[Number]) -> Array:
    """Return orthonormal combinations of numbers that matter, (numbers, K)."""
    whole = np.eye(len(numbers))
    links = np.array([one.name == LINK_PARAMETERS.name for one in numbers])
    if isinstance(problem, TorqueLog) or not links.any():
        return whole
    columns = _seen_by_torque(
        problem, [n for n in numbers if n.name == LINK_PARAMETERS.name]
    )
    _, sizes, vectors = np.linalg.svd(columns, full_matrices=False)
    kept = vectors[sizes > _SEEN * np.sqrt(len(columns))]
    inside = np.zeros((len(numbers), len(kept)))
    inside[links] = kept.T
    return np.concatenate([whole[:, ~links], inside], axis=1)


def _seen_by_torque(problem: ArmRollouts, numbers: Sequence[Number]) -> Array:
    """Return what each number does to a servo's position, in noise, (rows, numbers).

    A servo of stiffness k gives way by torque / k.
    """
    model, joints = problem.model, problem.log.joints
    parts = []
    for one in problem.log.recordings:
        every = max(1, one.rows // 100)
        found = smooth_motion(one.time, np.asarray(one.position), _SMOOTH)
        parts.append([part[::every] for part in found])
    position, velocity, acceleration = (
        np.concatenate([part[i] for part in parts]) for i in range(3)
    )
    stiffness = np.full(len(joints), np.inf)
    for column, joint in enumerate(joints):
        actuator = actuator_of(model, joint)
        if actuator >= 0:
            gear = model.actuator_gear[actuator, 0] ** 2
            stiffness[column] = -gear * model.actuator_biasprm[actuator, 1]
    moves = np.where(stiffness > 0.0, stiffness, np.inf) * problem.noise
    # A motor without feedback does not give way: its torque counts as it is.
    moves[~np.isfinite(moves)] = 1e-3
    dofs = np.array([int(model.joint(joint).dofadr[0]) for joint in joints])

    def torque(amounts: Array) -> Array:
        spec = problem.spec.copy()
        spec.option.disableflags |= _UNCONSTRAINED
        apply_to_spec(spec, effects_of(model, numbers, amounts))
        motion = position, velocity, acceleration
        return inverse_dynamics(spec.compile(), dofs, motion)[0]

    at, step = torque(np.zeros(len(numbers))), 0.3
    rows = [
        ((torque(step * row) - at) / step / moves).ravel()
        for row in np.eye(len(numbers))
    ]
    return np.stack(rows, axis=1)


class _Fit:
    """A fit under way."""

    def __init__(
        self,
        problem: Calibratable,
        numbers: Sequence[Number],
        basis: Array,
        recordings: tuple[int, ...],
        amounts: Array | None = None,
    ) -> None:
        self.problem, self.numbers, self.basis = problem, numbers, basis
        self.recordings = recordings
        layout = problem.layout
        self.near = np.flatnonzero(np.isin(layout.recording, recordings))
        self.scale = problem.noise[layout.channel[self.near]]
        self.amounts = np.zeros(basis.shape[1]) if amounts is None else amounts
        low = np.array([one.low for one in numbers])
        # Combinations of link numbers have no bounds.
        self.low = np.full(basis.shape[1], -np.inf)
        for row, bound in enumerate(low):
            if np.isfinite(bound):
                self.low[np.abs(basis[row]).argmax()] = bound
        self.residual = self.rows([self.amounts])[0]
        self.cost = float(np.mean(self.residual**2))
        self.jacobian = np.zeros((len(self.residual), len(self.amounts)))

    def rows(self, amounts: Sequence[Array]) -> Array:
        hypotheses = [
            Hypothesis(effects_of(self.problem.model, self.numbers, self.basis @ one))
            for one in amounts
        ]
        found = self.problem.residuals(hypotheses, self.recordings)
        return np.asarray(found / self.scale)

    def differentiate(self) -> None:
        steps = _DIFFERENCE * np.eye(len(self.amounts))
        rows = self.rows([self.amounts + step for step in steps])
        fine = np.asarray(np.isfinite(rows).all(axis=1))
        rows = np.where(fine[:, None], rows, self.residual)
        self.jacobian = (rows - self.residual).T / _DIFFERENCE

    def step(self) -> float:
        """Take a step; return the part of the cost that it saved."""
        self.differentiate()
        # What a model that is wrong otherwise, too, leaves counts as noise.
        weight = self._robust_weights() / np.sqrt(self.length())
        rows = np.concatenate(
            [weight[:, None] * self.jacobian, np.eye(len(self.amounts))]
        )
        goal = np.concatenate([-weight * self.residual, -self.amounts])
        _, triangle = np.linalg.qr(np.column_stack([rows, goal]))
        low = np.minimum(self.low - self.amounts, -1e-9)
        most = np.full(len(low), np.inf)
        whole = lsq_linear(triangle[:, :-1], triangle[:, -1], (low, most)).x
        tried = [self.amounts + part * whole for part in _SHORTER]
        residuals = self.rows(tried)
        totals = np.sum((weight * residuals) ** 2, axis=1)
        totals += [one @ one for one in tried]
        totals[~np.isfinite(totals)] = np.inf
        best = int(np.argmin(totals))
        before = float(
            np.sum((weight * self.residual) ** 2) + self.amounts @ self.amounts
        )
        if not totals[best] < before:
            return 0.0
        self.amounts, self.residual = tried[best], residuals[best]
        self.cost = float(np.mean(self.residual**2))
        return 1.0 - float(totals[best]) / before

    def weights(self) -> Array:
        """Return one over the noise or the channel's residual, where larger, (N,)."""
        channel = self.problem.layout.channel[self.near]
        counts = np.maximum(np.bincount(channel), 1)
        squares = np.bincount(channel, weights=self.residual**2) / counts
        return np.asarray(1.0 / np.sqrt(np.maximum(squares, 1.0)))[channel]

    def _robust_weights(self) -> Array:
        """Return `weights` by seconds of a channel, (N,).

        Where an arm that is too weak or too heavy falls, a few seconds of a channel are
        far off: they would decide on all numbers.
        """
        _, place = np.unique(self._series(), return_inverse=True)
        counts = np.bincount(place)
        squares = (np.bincount(place, weights=self.residual**2) / counts)[place]
        least = _PART / self.weights() ** 2
        return np.asarray(1.0 / np.sqrt(np.maximum(np.maximum(squares, least), 1.0)))

    def _series(self) -> Integers:
        layout = self.problem.layout
        series = seconds_of(layout) * len(layout.channels) + layout.channel
        return np.asarray(series[self.near])

    def length(self) -> float:
        """Return how many rows count as one."""
        return correlation_length(self.weights() * self.residual, self._series())

    def normal(self) -> Array:
        """Return squared derivatives in units of the weights, (K, K)."""
        weighted = self.weights()[:, None] * self.jacobian
        return np.asarray(weighted.T @ weighted)


def fitted_effects(
    problem: Calibratable, calibration: Calibration
) -> tuple[AppliedEffect, ...]:
    """Return a calibration as effects on the model."""
    return effects_of(problem.model, calibration.numbers, calibration.amounts)
