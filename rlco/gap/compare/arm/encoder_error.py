"""The change of a rollout's residuals by an error of an encoder over its position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.arm.free_torque import hats
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Integers
from rlco.gap.compare.segments import joint_velocity
from rlco.gap.logs.log import Array

_QUANTILES = np.linspace(0.01, 0.99, 8)  # of the position: knots of its error


@dataclass(frozen=True)
class EncoderError:
    """Errors of a joint's encoder at several positions.

    An eccentric disc or a worn potentiometer reads wrong by a smooth function of where
    the joint is. It moves nothing, so it changes that joint's residual alone.

    Attributes:
        joint: The joint.
        position: Knots [rad or m], (P,).
        moved: Change of the residuals by an error of one at each knot, (P, N).
    """

    joint: str
    position: Array
    moved: Array


def encoder_error(problem: ArmRollouts, joint: str) -> EncoderError:
    """Return what an error of a joint's encoder would change."""
    layout = problem.layout
    own = np.flatnonzero(layout.channel == problem.log.joints.index(joint))
    position, _ = at_times(problem, joint, layout.recording[own], layout.time[own])
    knots = np.unique(np.quantile(position, _QUANTILES))
    moved = np.zeros((len(knots), len(layout.channel)))
    moved[:, own] = -hats(position, knots)
    return EncoderError(joint, knots, moved)


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
