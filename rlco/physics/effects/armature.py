"""Inertia of a rotor behind its gear: MuJoCo's ``armature``."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter, joint_of
from rlco.physics.effects.targets import dof_of, holding_torque, joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    present = float(model.dof_armature[dof_of(model, str(target))])
    scale = max(present, 0.01 * holding_torque(model, str(target)), 1e-4)
    starts = (scale, 4.0 * scale, -0.4 * present)
    unit = "kg m^2"
    return (Parameter("armature", unit, -0.95 * present, 200 * scale, 0.0, starts),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    joint_of(spec, target).armature += values[0]


EFFECT = Effect(
    name="armature",
    summary=(
        "Inertia that a joint's motor adds, by its rotor and the square of its gear."
    ),
    signature="A residual in phase with acceleration, overshoot, nothing in holds.",
    confused_with=("link_inertia", "payload", "actuator_lag"),
    targets=joints,
    parameters=_parameters,
    on_spec=_on_spec,
)
