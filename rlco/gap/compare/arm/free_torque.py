"""The change of a rollout by a small torque of any form at one joint.

The form is a sum of hats over the joint's position and over its velocity, each hat with
an amount of its own. Along the measured motion each is a torque over time; the rollout
with a little of it says what it does to the positions, which is linear for little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.segments import earlier_steps, joint_velocity
from rlco.gap.logs.log import Array, Recording
from rlco.physics.effects.targets import actuator_of

_PLACES = np.linspace(0.02, 0.98, 6)  # of the knots, quantiles of the position
_SPEEDS = np.array([-1.0, -0.4, -0.1, 0.1, 0.4, 1.0])  # of the fastest
_SMALL = 5e-3  # size of the tried torque, as a servo's error [rad or m]


@dataclass(frozen=True)
class FreeTorque:
    """Torques at one joint in the form of hats.

    Attributes:
        joint: The joint.
        position: Knots [rad or m], (P,).
        velocity: Knots [rad/s or m/s], (V,).
        moved: Change of the residuals per unit of torque at each knot, first those of
            the position, (P + V, N).
    """

    joint: str
    position: Array
    velocity: Array
    moved: Array


def hats(values: Array, knots: Array) -> Array:
    """Return how much of each knot a value has, 1 in all, (knots, T).

    Example:
        >>> hats(np.array([0.0, 0.25, 5.0]), np.array([0.0, 1.0])).tolist()
        [[1.0, 0.75, 0.0], [0.0, 0.25, 1.0]]
    """
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def servo_gain(problem: ArmRollouts, hypothesis: Hypothesis, actuator: int) -> float:
    """Return the torque of a servo per unit of its command [N m/rad or N/m]."""
    model = problem.compiled(hypothesis)
    return float(model.actuator_gainprm[actuator, 0] * model.actuator_gear[actuator, 0])


def session_begins(logs: Sequence[Recording]) -> Array:
    """Return what to add to each recording's clock so that they follow one another [s].

    Shape (recordings,).
    """
    before = np.cumsum([0.0, *(one.seconds for one in logs)])[:-1]
    return np.asarray(before - np.array([one.time[0] for one in logs]))


def knots_of(position: Array, velocity: Array) -> tuple[Array, Array] | None:
    """Return the knots over position and over velocity; None where nothing moves.

    Args:
        position: Of one joint, (T,).
        velocity: (T,).
    """
    places = np.quantile(position, _PLACES)
    fastest = float(np.quantile(np.abs(velocity), 0.98))
    if fastest == 0.0 or not (np.diff(places) > 0).all():
        return None
    return np.asarray(places), fastest * _SPEEDS


def free_torque(
    problem: ArmRollouts,
    hypothesis: Hypothesis,
    joint: str,
    recordings: Sequence[int],
) -> FreeTorque | None:
    """Return what torques of any form at a joint would change; None without a motor.

    Args:
        problem: The robot and its log.
        hypothesis: What acts already.
        joint: Its servo adds the torque.
        recordings: Their residuals, in the order of the layout.
    """
    actuator = actuator_of(problem.model, joint)
    if actuator < 0:
        return None
    gain = servo_gain(problem, hypothesis, actuator)
    column = problem.log.joints.index(joint)
    logs = [problem.log.recordings[index] for index in recordings]
    position = [np.asarray(one.position, dtype=float)[:, column] for one in logs]
    velocity = [joint_velocity(one)[:, column] for one in logs]
    knots = knots_of(np.concatenate(position), np.concatenate(velocity))
    if gain == 0.0 or knots is None:
        return None
    places, speeds = knots
    small = _SMALL * abs(gain) if problem.model.actuator_biasprm[actuator, 1] else 0.0
    small = small or _SMALL
    step = float(problem.model.opt.timestep)
    pushes: list[dict[int, Array]] = [{} for _ in range(len(places) + len(speeds))]
    for index, log, place, speed in zip(
        recordings, logs, position, velocity, strict=True
    ):
        shape = np.concatenate([hats(place, places), hats(speed, speeds)])
        before = earlier_steps(log, step)
        steps = before + round(log.seconds / step) + 1
        times = log.time[0] + step * (np.arange(steps) - before)
        for push, row in zip(pushes, shape, strict=True):
            change = np.zeros((steps, problem.model.nu))
            change[:, actuator] = small * np.interp(times, log.time, row) / gain
            push[index] = change
    rows = problem.pushed(hypothesis, [{}, *pushes], recordings)
    if not np.isfinite(rows).all():
        return None
    return FreeTorque(joint, places, speeds, (rows[1:] - rows[0]) / small)
