"""A servo's stiffness or a motor's strength, times a factor."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, actuators_of
from rlco.physics.effects.targets import driven_joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("factor", "", 0.1, 10.0, 1.0, (0.75, 1.35)),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    for actuator in actuators_of(spec, target):
        gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
        gain[0] *= values[0]
        bias[1] *= values[0]
        actuator.gainprm, actuator.biasprm = gain, bias


EFFECT = Effect(
    name="actuator_gain",
    summary=(
        "An actuator pulls with another strength: a servo's stiffness kp, or a "
        "motor's torque, times a factor."
    ),
    signature=(
        "Offsets in holds that scale with the load; faster or slower answers to steps."
    ),
    confused_with=("payload", "torque_limit", "encoder_scale", "viscous_damping"),
    targets=driven_joints,
    parameters=_parameters,
    on_spec=_on_spec,
)
