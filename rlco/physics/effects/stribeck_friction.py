"""Friction that is larger at rest than in motion."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter, StepTerms, joint_of
from rlco.physics.effects.targets import holding_torque, joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    speeds = (0.05, 0.2)
    return (
        Parameter("static", "N m", 0.0, 20.0 * torque, 0.0, (0.2 * torque,)),
        Parameter("speed", "rad/s", 0.005, 1.0, 0.1, speeds),
    )


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    # MuJoCo makes a friction constraint only where the friction is above zero.
    joint = joint_of(spec, target)
    joint.frictionloss = max(joint.frictionloss, 1e-9)


def _on_step(terms: StepTerms, dof: int, actuator: int, values: Array) -> None:
    terms.static[dof] = values[0]
    terms.stribeck_speed[dof] = values[1]


EFFECT = Effect(
    name="stribeck_friction",
    summary="Friction at rest, beyond Coulomb's, that falls as exp(-(v/speed)^2).",
    signature="More torque below some 0.1 rad/s, stick and slip, jumps out of holds.",
    confused_with=("coulomb_friction", "load_friction", "backlash"),
    targets=joints,
    parameters=_parameters,
    on_spec=_on_spec,
    on_step=_on_step,
)
