"""The numbers of a model that are always a little wrong, and by how much: priors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Array
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.effects.actuator import (
    ACTUATOR_GAIN,
    SERVO_DAMPING,
    TORQUE_BIAS,
)
from rlco.physics.effects.friction import COULOMB_FRICTION, VISCOUS_DAMPING
from rlco.physics.effects.inertia import ARMATURE
from rlco.physics.effects.link_parameters import (
    LINK_NUMBERS,
    LINK_PARAMETERS,
    TORQUE_OFFSET,
    TORQUE_SCALE,
)
from rlco.physics.effects.targets import (
    actuator_of,
    dof_of,
    driven_joints,
    holding_torque,
    moving_bodies,
    servo_joints,
)

Calibratable = ArmRollouts | TorqueLog
RELATIVE = 0.25  # of friction, damping and armature that the model has
GAIN = 0.2  # of a drive's gain or a torque's factor, logarithmic
# Of what a model lacks: parts of the torque that holds the joint's links, and of the
# largest among the joints, since a wrist carries little and rubs all the same.
_OWN, _LARGEST = 0.05, 0.01
_OF_INERTIA = 0.1  # of an armature, as a part of the joint's inertia
_MASS, _SHAPE, _CENTRE = 0.12, 0.15, 0.25  # see `LINK_NUMBERS`
_LEAST_MASS = 1e-3  # [kg]


@dataclass(frozen=True)
class Number:
    """One number of a model, and its prior.

    Attributes:
        name: The effect that changes it.
        target: Its joint or body.
        parameter: The effect's parameter.
        deviation: Standard deviation of the prior, of the logarithm of a factor.
        low: Smallest change, in standard deviations.
        factor: Whether the parameter is a factor.
    """

    name: str
    target: str
    parameter: str
    deviation: float
    low: float = -np.inf
    factor: bool = False

    def value(self, amount: float) -> float:
        """Return the parameter at so many standard deviations from the model's."""
        change = self.deviation * max(amount, self.low)
        return float(np.exp(change)) if self.factor else change


def usual_numbers(problem: Calibratable) -> list[Number]:
    """Return the numbers that a calibration fits, in the order of joints and links."""
    model, joints = problem.model, problem.log.joints
    found = [one for joint in joints for one in _of_joint(problem, joint)]
    for body in moving_bodies(model):
        if model.body(body).mass[0] > _LEAST_MASS:
            found += _of_link(body)
    return found


def _of_joint(problem: Calibratable, joint: str) -> Iterator[Number]:
    model = problem.model
    dof, actuator = dof_of(model, joint), actuator_of(model, joint)
    largest = max(holding_torque(model, name) for name in problem.log.joints)
    torque = max(_OWN * holding_torque(model, joint), _LARGEST * largest)
    feedback = 0.0
    if actuator >= 0 and isinstance(problem, ArmRollouts):
        gear = float(model.actuator_gear[actuator, 0])
        feedback = gear**2 * max(0.0, -float(model.actuator_biasprm[actuator, 2]))
    friction, damping = model.dof_frictionloss[dof], model.dof_damping[dof]
    armature = model.dof_armature[dof]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = float(data.qM[model.dof_Madr[dof]])

    def added(name: str, parameter: str, present: float, deviation: float) -> Number:
        low = -0.95 * float(present) / deviation
        return Number(name, joint, parameter, deviation, low)

    yield added(
        COULOMB_FRICTION.name,
        "frictionloss",
        friction,
        max(RELATIVE * friction, torque),
    )
    usual = max(RELATIVE * damping, torque)
    yield added(VISCOUS_DAMPING.name, "damping", damping, usual)
    if feedback > 0.0:
        # Not the joint's own: at its limit a motor damps nothing.
        yield Number(SERVO_DAMPING.name, joint, "factor", GAIN, factor=True)
    usual = max(RELATIVE * armature, _OF_INERTIA * inertia)
    yield added(ARMATURE.name, "armature", armature, usual)
    if isinstance(problem, TorqueLog):
        yield Number(TORQUE_SCALE.name, joint, "factor", GAIN, factor=True)
        yield Number(TORQUE_OFFSET.name, joint, "offset", torque)
        return
    if joint in servo_joints(model):
        yield Number(ACTUATOR_GAIN.name, joint, "factor", GAIN, factor=True)
    if joint in driven_joints(model):
        yield Number(TORQUE_BIAS.name, joint, "torque", torque)


def _of_link(body: str) -> Iterator[Number]:
    sizes = [_MASS] + [_SHAPE] * 6 + [_CENTRE] * 3
    for name, size in zip(LINK_NUMBERS, sizes, strict=True):
        yield Number(LINK_PARAMETERS.name, body, name, size)


def effects_of(
    model: mujoco.MjModel, numbers: Sequence[Number], amounts: Array
) -> tuple[AppliedEffect, ...]:
    """Return the effects that numbers make at so many standard deviations.

    Args:
        model: The model without them.
        numbers: The numbers, N of them.
        amounts: (N,).
    """
    groups: dict[tuple[str, str], dict[str, float]] = {}
    for number, amount in zip(numbers, amounts, strict=True):
        values = groups.setdefault((number.name, number.target), {})
        values[number.parameter] = number.value(float(amount))
    effects = []
    for (name, target), values in groups.items():
        known = EFFECTS[name].parameters(model, target)
        inside = {p.name: values.get(p.name, p.neutral) for p in known}
        effects.append(AppliedEffect(name, target, inside))
    return tuple(effects)
