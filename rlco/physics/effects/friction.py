"""Friction of joints: Coulomb, by direction, viscous, Stribeck, by the load."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, Present, joint_of
from rlco.physics.effects.targets import (
    dof_of,
    driven_joints,
    holding_torque,
    joints,
    motor_torque,
)

_SLOWEST = 0.25  # rad/s, or m/s, that a motor reaches against the strongest damping


def _coulomb_friction_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    starts = (0.1 * torque, 0.4 * torque)
    present = Present(float(model.dof_frictionloss[dof_of(model, str(target))]))
    size = ("frictionloss", "N m", 0.0, 20.0 * torque, 0.0, starts)
    return (Parameter(*size, present=present),)


def _coulomb_friction_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    joint_of(spec, target).frictionloss += values[0]


COULOMB_FRICTION = Effect(
    name="coulomb_friction",
    summary="A torque of constant size against the motion of a joint.",
    signature=(
        "A residual that flips its sign at reversals, and holds whose offset "
        "depends on the side they were approached from."
    ),
    confused_with=("stribeck_friction", "load_friction", "backlash", "viscous_damping"),
    targets=joints,
    parameters=_coulomb_friction_parameters,
    on_spec=_coulomb_friction_on_spec,
    at_fixtures=True,
    tolerances=("friction",),
)


def _viscous_damping_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    present = float(model.dof_damping[dof_of(model, str(target))])
    scale = max(present, 0.05)
    starts = (0.5 * scale, 4.0 * scale, -0.4 * present)
    # Beyond, a motor at its limit hardly moves the joint.
    slowest = motor_torque(model, str(target)) / _SLOWEST
    most = max(200 * scale, holding_torque(model, str(target)), slowest)
    size = ("damping", "N m s/rad", -0.95 * present, most, 0.0, starts)
    return (Parameter(*size, present=Present(present)),)


def _viscous_damping_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    joint = joint_of(spec, target)
    damping = np.array(joint.damping, dtype=float)
    # Linear, quadratic and cubic in newer MuJoCo; a single number in older.
    joint.damping = damping + np.eye(len(damping))[0] * values[0]


VISCOUS_DAMPING = Effect(
    name="viscous_damping",
    summary="A torque against the motion of a joint, in proportion to its speed.",
    signature=(
        "A residual in phase with speed, that grows with it and is gone in holds."
    ),
    confused_with=(
        "actuator_lag",
        "command_delay",
        "actuator_gain",
        "coulomb_friction",
    ),
    targets=joints,
    parameters=_viscous_damping_parameters,
    on_spec=_viscous_damping_on_spec,
    at_fixtures=True,
    tolerances=("damping",),
)


def _stribeck_friction_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    speeds = (0.05, 0.2)
    return (
        Parameter("static", "N m", 0.0, 20.0 * torque, 0.0, (0.2 * torque,)),
        Parameter("speed", "rad/s", 0.005, 1.0, 0.1, speeds),
    )


def _stribeck_friction(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    return values[0] * math.exp(-((velocity / values[1]) ** 2))


STRIBECK_FRICTION = Effect(
    name="stribeck_friction",
    summary="Friction at rest, beyond Coulomb's, that falls as exp(-(v/speed)^2).",
    signature="More torque below some 0.1 rad/s, stick and slip, jumps out of holds.",
    confused_with=("coulomb_friction", "load_friction", "backlash"),
    targets=joints,
    parameters=_stribeck_friction_parameters,
    friction=_stribeck_friction,
)


def _load_friction_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("ratio", "", 0.0, 2.0, 0.0, (0.05, 0.2)),)


def _load_friction(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    return values[0] * carried


LOAD_FRICTION = Effect(
    name="load_friction",
    summary=(
        "Friction in proportion to the torque between motor and load, |motor - load|."
    ),
    signature="A dead zone that grows with the load; the arm sticks in loaded holds.",
    confused_with=(
        "coulomb_friction",
        "stribeck_friction",
        "backlash",
        "actuator_gain",
    ),
    targets=driven_joints,
    parameters=_load_friction_parameters,
    friction=_load_friction,
)


def _directional_friction_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    starts = (0.1 * torque, 0.4 * torque)
    return (
        Parameter("forward", "N m", 0.0, 20.0 * torque, 0.0, starts),
        Parameter("backward", "N m", 0.0, 20.0 * torque, 0.0, starts),
    )


def _directional_friction(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    return 0.5 * (values[0] + values[1])


def _directional_bias(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    return 0.5 * (values[1] - values[0])


# At rest and in motion the two torques are those of a friction with a constant torque
# beside it, so that no recording tells one from the other, and none is searched.
DIRECTIONAL_FRICTION = Effect(
    name="directional_friction",
    summary="Friction of one size in the positive direction, of another backwards.",
    signature="Residuals of two sizes after reversals, by the direction of motion.",
    confused_with=("coulomb_friction", "torque_bias"),
    targets=joints,
    parameters=_directional_friction_parameters,
    friction=_directional_friction,
    torque=_directional_bias,
    at_fixtures=True,
    candidate=False,
)
