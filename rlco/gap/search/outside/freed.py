"""A joint that is set free, and the torque and encoder's error that fit best there.

The torque is first what keeps the joint on its measured path, however large, then
improved by least squares, and its changes are measured again where it then is: large
knocks are not linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from rlco.gap.compare.arm.encoder_error import EncoderError, encoder_error
from rlco.gap.compare.arm.following_torque import following_torque
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.arm.torque_over_time import (
    TorqueOverTime,
    torque_over_time,
    with_amounts,
    with_hats,
)
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.logs.log import Array
from rlco.gap.search.outside.course import Begun, Course, begun
from rlco.gap.search.state import State
from rlco.gap.search.whitening import often

_ROUNDS = 6  # estimates of a torque of any course
_FEW = 2  # the same of one that has few amounts
_PARTS = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried
_SMALLER = 0.1  # share of the residual that a round must remove to be followed
USUAL_ERROR = 0.1  # size of an encoder's error [rad or m]


@dataclass(frozen=True)
class Freed:
    """A joint set free: what it does, and with which torques the robot is compared.

    Attributes:
        problem: The robot with the torque, and its log.
        torques: Hats over time.
        free: Which of these may change, (K,).
        amounts: Of each hat in all, (K,).
        encoder: Errors of its encoder that its servo follows; None for none, and where
            the torque takes any course.
        errors: Those that were put right, of `USUAL_ERROR`, (P,).
        any: Whether the torque takes any course.
    """

    problem: ArmRollouts
    torques: TorqueOverTime
    free: Array
    amounts: Array
    encoder: EncoderError | None
    errors: Array
    any: bool

    def columns(self) -> Array:
        """Return all changes, (free, N)."""
        if self.any:
            return self.torques.columns()
        return np.concatenate([self.torques.moved[self.free], self.misread()])

    def misread(self) -> Array:
        """Return the changes by errors that the servo follows, (P, N)."""
        if self.encoder is None:
            return np.zeros((0, self.torques.moved.shape[1]))
        return USUAL_ERROR * self.encoder.moved

    def residual(self, state: State, hypothesis: Hypothesis) -> float:
        """Return the root mean square of the residual beside the changes, whitened.

        Args:
            state: Of a search without it.
            hypothesis: What else acts.
        """
        (rows,) = self.problem.residuals([hypothesis])
        return Amounts.of(state, self.columns()).residual(rows)

    def changed(self, problem: ArmRollouts, amounts: Array) -> Freed:
        """Return the joint with other amounts of the changes, (free,).

        Args:
            problem: The robot without torque and error.
            amounts: What is added to each.
        """
        torques, errors = self.amounts.copy(), self.errors
        torques[self.free] += amounts[: int(self.free.sum())]
        if self.encoder is not None:
            errors = errors + amounts[int(self.free.sum()) :]
            error = self.encoder.error(USUAL_ERROR * errors)
            problem = problem.with_encoder_error(self.torques.joint, error)
        moved = with_amounts(problem, self.torques, torques)
        return replace(self, problem=moved, amounts=torques, errors=errors)


def estimated(
    state: State,
    problem: ArmRollouts,
    hypothesis: Hypothesis,
    joint: str,
    course: Course,
) -> Freed | None:
    """Return a joint set free, with the torque that fits best; None if it diverges.

    Args:
        state: Of a search without it.
        problem: Its robot and log.
        hypothesis: What else acts.
        joint: The joint.
        course: What may act at the joint.
    """
    followed = following_torque(problem, hypothesis, joint)
    if followed is None:
        return None
    first = begun(problem, joint, followed, course)
    if course.knocks and not course.drifts and not first.free.any():
        return None  # nothing is sudden
    freed = _measured(problem, hypothesis, joint, course, first)
    if freed is None:
        return None
    if course.any:
        return _improved(state, problem, hypothesis, freed)
    return _with_few(state, problem, hypothesis, freed)


def _measured(
    problem: ArmRollouts, hypothesis: Hypothesis, joint: str, course: Course, at: Begun
) -> Freed | None:
    """Return a joint set free with a torque to begin with."""
    moved = with_hats(problem, joint, at.knots, at.torques)
    torques = torque_over_time(moved, hypothesis, joint, at.knots)
    if torques is None:
        return None
    encoder, errors = None, np.zeros(0)
    if course.misreads:
        logs = range(len(problem.log.recordings))
        encoder = encoder_error(moved, hypothesis, joint, logs)
        if encoder is None:
            return None
        errors = np.zeros(len(encoder.position))
    amounts = np.concatenate(at.torques) / torques.torque
    return Freed(moved, torques, at.free, amounts, encoder, errors, course.any)


def _with_few(
    state: State, problem: ArmRollouts, hypothesis: Hypothesis, freed: Freed
) -> Freed | None:
    """Return a joint set free with its torque improved, beside its encoder's error."""
    for _ in range(_FEW):
        (rows,) = freed.problem.residuals([hypothesis])
        if not np.isfinite(rows).all():
            return None
        fitted = Amounts.of(state, freed.columns()).fitted(rows)
        freed = freed.changed(problem, fitted[len(state.setting.prior) :])
    return freed


def _improved(
    state: State, problem: ArmRollouts, hypothesis: Hypothesis, freed: Freed
) -> Freed | None:
    """Return a joint set free with a torque of any course improved."""
    scale = problem.noise[problem.layout.channel]

    def compared(moved: ArmRollouts) -> tuple[float, Array]:
        (rows,) = moved.residuals([hypothesis])
        return float(np.sqrt(np.mean((rows / scale) ** 2))), rows

    torques, moved, total = freed.torques, freed.problem, freed.amounts
    size, rows = compared(moved)
    if not np.isfinite(size):
        return None
    knots = [
        torques.time[torques.recording == i] for i in range(len(problem.log.recordings))
    ]
    for _ in range(_ROUNDS):
        # Torques alone: an encoder's error would cancel a constant one.
        fitted = Amounts.of(state, torques.moved).fitted(rows)
        step, before = fitted[len(state.setting.prior) :], size
        for part in _PARTS:
            # A motor at its limit does not hold against more: whole steps go too far.
            trial = with_amounts(problem, torques, total + part * step)
            size, rows = compared(trial)
            if size < before:
                break
        else:
            break
        moved, total = trial, total + part * step
        again = torque_over_time(moved, hypothesis, torques.joint, knots)
        if again is None:
            return None
        torques = again
        if size > (1.0 - _SMALLER) * before:
            break
    return replace(freed, problem=moved, torques=torques, amounts=total)


@dataclass(frozen=True)
class Amounts:
    """Amounts of changes that make residuals smallest, by ridge regression.

    Those of a free torque each reach over few rows, so their products are sparse.
    """

    columns: Any  # in units of the noise, each times its prior, (changes, N)
    solve: Callable[[Array], Array]
    prior: Array
    scale: Array

    @classmethod
    def of(cls, state: State, free: Array) -> Amounts:
        """Return them for the tolerance's parameters and free changes (free, N)."""
        setting, problem = state.setting, state.setting.problem
        scale = problem.noise[problem.layout.channel]
        counts = often(len(scale) if problem.calibration is None else -1)
        prior = setting.prior / np.sqrt(counts)
        tolerance = setting.weights.moved * prior[:, None] / scale
        columns = sparse.vstack(
            [sparse.csr_array(tolerance), sparse.csr_array(free / scale)], format="csr"
        )
        squares = (columns @ columns.T).toarray()
        factor = cho_factor(squares + np.eye(len(squares)))
        whole = np.concatenate([prior, np.ones(len(free))])
        return cls(columns, lambda rows: cho_solve(factor, rows), whole, scale)

    def fitted(self, rows: Array) -> Array:
        """Return the amounts for residuals (N,), (changes,)."""
        along = self.columns @ (rows / self.scale)
        return np.asarray(-self.solve(along) * self.prior)

    def residual(self, rows: Array) -> float:
        """Return the root mean square of residuals (N,), whitened."""
        if not np.isfinite(rows).all():
            return float("inf")
        scaled = rows / self.scale
        along = self.columns @ scaled
        square = float(scaled @ scaled - along @ self.solve(along))
        return float(np.sqrt(max(square, 0.0) / len(rows)))
