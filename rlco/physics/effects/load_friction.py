"""Friction that grows with the torque that a gear transmits."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter, StepTerms, joint_of
from rlco.physics.effects.targets import driven_joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("ratio", "", 0.0, 2.0, 0.0, (0.05, 0.2)),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    # MuJoCo makes a friction constraint only where the friction is above zero.
    joint = joint_of(spec, target)
    joint.frictionloss = max(joint.frictionloss, 1e-9)


def _on_step(terms: StepTerms, dof: int, actuator: int, values: Array) -> None:
    terms.load[dof] = values[0]


EFFECT = Effect(
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
    parameters=_parameters,
    on_spec=_on_spec,
    on_step=_on_step,
)
