"""Viscous damping of a joint: MuJoCo's ``damping``."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, joint_of
from rlco.physics.effects.targets import dof_of, joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    present = float(model.dof_damping[dof_of(model, str(target))])
    scale = max(present, 0.05)
    starts = (0.5 * scale, 4.0 * scale, -0.4 * present)
    unit = "N m s/rad"
    return (Parameter("damping", unit, -0.95 * present, 200 * scale, 0.0, starts),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    joint = joint_of(spec, target)
    damping = np.array(joint.damping, dtype=float)
    # Linear, quadratic and cubic in newer MuJoCo; one number in older.
    joint.damping = damping + np.eye(len(damping))[0] * values[0]


EFFECT = Effect(
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
    parameters=_parameters,
    on_spec=_on_spec,
)
