"""A transmission that gives: a spring between motor and link."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, actuators_of, joint_of
from rlco.physics.effects.targets import holding_torque, servo_joints

# The spring's own damping: it settles within some periods instead of ringing on.
_DAMPING_RATIO = 0.05
SUFFIX = "_compliance"


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    # Told by its inverse, which is zero for a stiff joint.
    scale = 1.0 / holding_torque(model, str(target))
    starts = (0.02 * scale, 0.1 * scale)
    return (Parameter("compliance", "rad/(N m)", 0.0, scale, 0.0, starts),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    if values[0] < 1e-9:
        return
    joint = joint_of(spec, target)
    actuators_of(spec, target)
    stiffness = 1.0 / float(values[0])
    parent = joint.parent
    link = parent.add_joint(name=f"{target}{SUFFIX}")
    link.type, link.axis, link.pos = joint.type, joint.axis, joint.pos
    size = len(np.array(joint.stiffness, dtype=float))
    link.stiffness = np.eye(size)[0] * stiffness
    # With the motor's inertia m, the spring rings at sqrt(k / m).
    inertia = max(float(joint.armature), 1e-4)
    damping = 2.0 * _DAMPING_RATIO * np.sqrt(stiffness * inertia)
    link.damping = np.eye(size)[0] * damping
    link.armature = 1e-6
    # Nothing of what a class gives to joints is this spring's.
    link.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    link.frictionloss = link.springref = link.ref = 0.0


EFFECT = Effect(
    name="joint_compliance",
    summary=(
        "A spring between a motor and its link; the servo holds the motor, the "
        "log tells the link."
    ),
    signature="A residual in proportion to torque, and ringing after fast changes.",
    confused_with=("actuator_gain", "backlash", "payload"),
    targets=servo_joints,
    parameters=_parameters,
    on_spec=_on_spec,
)
