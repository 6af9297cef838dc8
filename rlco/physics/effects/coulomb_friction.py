"""Coulomb friction of a joint: MuJoCo's ``frictionloss``."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter, joint_of
from rlco.physics.effects.targets import holding_torque, joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    starts = (0.1 * torque, 0.4 * torque)
    return (Parameter("frictionloss", "N m", 0.0, 20.0 * torque, 0.0, starts),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    joint_of(spec, target).frictionloss += values[0]


EFFECT = Effect(
    name="coulomb_friction",
    summary="A torque of constant size against the motion of a joint.",
    signature=(
        "A residual that flips its sign at reversals, and holds whose offset "
        "depends on the side they were approached from."
    ),
    confused_with=("stribeck_friction", "load_friction", "backlash", "viscous_damping"),
    targets=joints,
    parameters=_parameters,
    on_spec=_on_spec,
)
