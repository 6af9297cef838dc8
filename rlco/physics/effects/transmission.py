"""Transmission between a motor and its link: play, compliance, cogging; springs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numba import njit

from rlco.physics.effects.effect import Array, Effect, Parameter, actuators_of, joint_of
from rlco.physics.effects.targets import (
    driven_hinges,
    holding_torque,
    joints,
    servo_joints,
)


def _backlash_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("width", "rad", 0.0, 0.5, 0.0, (0.02, 0.08)),)


@njit(cache=True)
def _play(commands: Array, half: float) -> Array:
    followed = np.empty_like(commands)
    goal = commands[0]
    for step in range(len(commands)):
        goal = min(max(goal, commands[step] - half), commands[step] + half)
        followed[step] = goal
    return followed


def _backlash_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    goal = np.ascontiguousarray(commands[:, column])
    commands[:, column] = _play(goal, 0.5 * float(values[0]))
    return commands


BACKLASH = Effect(
    name="backlash",
    summary="Play of a given width between a servo and its joint.",
    signature=(
        "A plateau after each reversal, as wide as the play, at any speed and load."
    ),
    confused_with=("coulomb_friction", "stribeck_friction", "load_friction"),
    targets=servo_joints,
    parameters=_backlash_parameters,
    on_command=_backlash_on_command,
    order=40,
    shown_by=("positions",),
)


# The spring's own damping, so that it settles within some periods.
_DAMPING_RATIO = 0.05
COMPLIANCE_SUFFIX = "_compliance"


def _joint_compliance_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    # Parametrised by the inverse stiffness, which is zero for a stiff joint.
    scale = 1.0 / holding_torque(model, str(target))
    starts = (0.02 * scale, 0.1 * scale)
    return (Parameter("compliance", "rad/(N m)", 0.0, scale, 0.0, starts),)


def _joint_compliance_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    if values[0] < 1e-9:
        return
    joint = joint_of(spec, target)
    actuators_of(spec, target)
    stiffness = 1.0 / float(values[0])
    parent = joint.parent
    link = parent.add_joint(name=f"{target}{COMPLIANCE_SUFFIX}")
    link.type, link.axis, link.pos = joint.type, joint.axis, joint.pos
    size = len(np.array(joint.stiffness, dtype=float))
    link.stiffness = np.eye(size)[0] * stiffness
    # With the motor's inertia m, the spring oscillates at sqrt(k / m).
    inertia = max(float(joint.armature), 1e-4)
    damping = 2.0 * _DAMPING_RATIO * np.sqrt(stiffness * inertia)
    link.damping = np.eye(size)[0] * damping
    link.armature = 1e-6
    # Defaults that a class sets for joints do not apply to this spring.
    link.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    link.frictionloss = link.springref = link.ref = 0.0


JOINT_COMPLIANCE = Effect(
    name="joint_compliance",
    summary=(
        "A spring between a motor and its link; the servo holds the motor, the "
        "log reports the link."
    ),
    signature="A residual in proportion to torque, and ringing after fast changes.",
    confused_with=("actuator_gain", "backlash", "payload"),
    targets=servo_joints,
    parameters=_joint_compliance_parameters,
    on_spec=_joint_compliance_on_spec,
    shown_by=("positions",),
)


def _joint_stiffness_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    scale = holding_torque(model, str(target))
    stiffness = Parameter(
        "stiffness", "N m/rad", 0.0, 50.0 * scale, 0.0, (0.1 * scale, 0.5 * scale)
    )
    return (stiffness, Parameter("rest", "rad", -3.0, 3.0, 0.0, (0.0,)))


def _joint_stiffness_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    joint = joint_of(spec, target)
    stiffness = np.array(joint.stiffness, dtype=float)
    present = stiffness[0]
    total = max(present + values[0], 1e-12)
    # In a file in degrees, the rest angle of a hinge is in degrees, too.
    hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    rest = np.degrees(values[1]) if hinge and spec.compiler.degree else values[1]
    # Two springs act as one, at the mean of their rest angles weighted by stiffness.
    joint.springref = (present * joint.springref + values[0] * rest) / total
    joint.stiffness = stiffness + np.eye(len(stiffness))[0] * values[0]


JOINT_STIFFNESS = Effect(
    name="joint_stiffness",
    summary="A spring pulls a joint to a rest angle.",
    signature="A torque linear in the joint's angle, not in its sine.",
    confused_with=("torque_bias", "payload", "actuator_gain"),
    targets=joints,
    parameters=_joint_stiffness_parameters,
    on_spec=_joint_stiffness_on_spec,
    at_fixtures=True,
)


def _cogging_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    second = -20.0 * torque, 20.0 * torque, 0.0, (0.05 * torque,)
    return (
        Parameter("amplitude", "N m", 0.0, 20.0 * torque, 0.0, (0.1 * torque,)),
        # sin(n q) has n periods in a turn of q.
        Parameter("count", "1/turn", 1.0, 1e3, 20.0, (20.0,), scales=False, step=1e-2),
        Parameter("phase", "rad", -20.0, 20.0, 0.0, (1.0,)),
        Parameter("second_sine", "N m", *second),
        Parameter("second_cosine", "N m", *second),
    )


def _cogging(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    turn = values[1] * position + values[2]
    second = values[3] * math.sin(2.0 * turn) + values[4] * math.cos(2.0 * turn)
    return values[0] * math.sin(turn) + second


COGGING = Effect(
    name="cogging",
    summary="A torque periodic in position, count q + phase, and in twice of that.",
    signature=(
        "A ripple at the same places of a joint's path in every pass, at any speed."
    ),
    confused_with=("torque_bias", "joint_stiffness", "coulomb_friction"),
    targets=driven_hinges,
    parameters=_cogging_parameters,
    torque=_cogging,
    shown_by=("positions", "torques"),
    uncommon=True,
)


def _hardening_spring_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    scale = holding_torque(model, str(target))
    starts = (0.1 * scale, 0.5 * scale)
    return (
        Parameter("hardening", "N m/rad^3", 0.0, 5e3 * scale, 0.0, starts),
        Parameter("rest", "rad", -3.0, 3.0, 0.0, (0.0,)),
    )


def _hardening_spring(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    return -values[0] * (position - values[1]) ** 3


HARDENING_SPRING = Effect(
    name="hardening_spring",
    summary="A spring that hardens pulls a joint: -hardening (q - rest)^3.",
    signature="Little around one angle, and a torque that grows fast away from it.",
    confused_with=("joint_stiffness", "torque_bias", "payload"),
    targets=driven_hinges,
    parameters=_hardening_spring_parameters,
    torque=_hardening_spring,
    shown_by=("positions", "torques"),
    uncommon=True,
)
