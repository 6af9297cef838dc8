"""The change of a rollout's residuals by an error of an encoder over its position.

An eccentric disc or a worn potentiometer reads wrong by a smooth function of where the
joint is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from rlco.gap.compare.arm.free_torque import hats, servo_gain
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import joint_velocity
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import actuator_of

_SMALL = 0.005  # size of the error that is tried [rad or m]
KNOTS = 10  # of an error that is smooth
_QUANTILES = np.linspace(0.01, 0.99, 8)  # of the position: knots of its error


@dataclass(frozen=True)
class EncoderError:
    """Errors of a joint's encoder, which its servo reads, at several positions.

    Attributes:
        joint: The joint.
        position: Knots [rad or m], (P,).
        moved: Change of the residuals by an error of one at each knot, (P, N).
    """

    joint: str
    position: Array
    moved: Array

    def error(self, amounts: Array) -> Callable[[Array], Array]:
        """Return the error at positions, (T,) to (T,).

        Args:
            amounts: The error at each knot [rad or m], (P,).
        """
        return _error(self.position, amounts)


def encoder_error(
    problem: ArmRollouts,
    hypothesis: Hypothesis,
    joint: str,
    recordings: Sequence[int],
    count: int = KNOTS,
) -> EncoderError | None:
    """Return what an error of a joint's encoder would change; None without a motor.

    The servo drives what the encoder reads to the command: the joint itself is moved
    by as much as is read wrong, and what stays is that its motion is another one.

    Args:
        problem: The robot and its log.
        hypothesis: What acts already.
        joint: Its servo reads the encoder.
        recordings: Their residuals, in the order of the layout.
        count: Number of knots.
    """
    actuator = actuator_of(problem.model, joint)
    if actuator < 0 or servo_gain(problem, hypothesis, actuator) == 0.0:
        return None
    layout = problem.layout
    column = problem.log.joints.index(joint)
    own = np.flatnonzero(layout.channel == column)
    position, _ = at_times(problem, joint, layout.recording[own], layout.time[own])
    low, high = float(position.min()), float(position.max())
    if low == high:
        return None
    knots: Array = np.linspace(low, high, count, dtype=float)
    rows = [problem.residuals([hypothesis], recordings)]
    for amounts in _SMALL * np.eye(len(knots)):
        put_right = problem.with_encoder_error(joint, _error(knots, amounts))
        rows.append(put_right.residuals([hypothesis], recordings))
    every = np.concatenate(rows)
    if not np.isfinite(every).all():
        return None
    moved = (every[1:] - every[0]) / _SMALL
    return EncoderError(joint, knots, moved)


def _error(knots: Array, amounts: Array) -> Callable[[Array], Array]:
    """Return a smooth error with given values at knots, as a function."""
    return lambda positions: smooth_hats(positions, knots).T @ amounts


def smooth_hats(values: Array, knots: Array) -> Array:
    """Return how much of each knot a value has, 1 in all, (knots, T).

    Between the knots lie cubic splines, outside them the outermost holds.

    Example:
        >>> values, knots = np.array([0.0, 0.5, 3.0, 9.0]), np.arange(4.0)
        >>> (smooth_hats(values, knots).T @ knots).round(6).tolist()
        [0.0, 0.5, 3.0, 3.0]
    """
    spline = CubicSpline(knots, np.eye(len(knots)), bc_type="natural")
    return np.asarray(spline(np.clip(values, knots[0], knots[-1])).T)


def misread(problem: ArmRollouts, joint: str) -> Array:
    """Return the change where the encoder is read wrong, but the joint not moved.

    Of an error of one at each of several positions, (P, N).
    """
    layout = problem.layout
    own = np.flatnonzero(layout.channel == problem.log.joints.index(joint))
    position, _ = at_times(problem, joint, layout.recording[own], layout.time[own])
    knots = np.unique(np.quantile(position, _QUANTILES))
    moved = np.zeros((len(knots), len(layout.channel)))
    moved[:, own] = -hats(position, knots)
    return moved


def at_times(
    problem: ArmRollouts, joint: str, recording: Integers, time: Array
) -> tuple[Array, Array]:
    """Return position and velocity of a joint at times of recordings, (T,) both.

    Args:
        problem: The robot and its log.
        joint: The joint.
        recording: Recording of each time, (T,).
        time: On its clock [s], (T,).
    """
    column = problem.log.joints.index(joint)
    position, velocity = np.zeros(len(time)), np.zeros(len(time))
    for index, one in enumerate(problem.log.recordings):
        own = recording == index
        path = np.asarray(one.position, dtype=float)[:, column]
        position[own] = np.interp(time[own], one.time, path)
        speed = joint_velocity(one)[:, column]
        velocity[own] = np.interp(time[own], one.time, speed)
    return position, velocity
