"""A constant torque on a joint."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, actuators_of
from rlco.physics.effects.targets import driven_joints, holding_torque


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    bound = 5.0 * torque
    starts = (0.1 * torque, -0.1 * torque)
    return (Parameter("torque", "N m", -bound, bound, 0.0, starts),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    actuator = actuators_of(spec, target)[0]
    bias = np.array(actuator.biasprm)
    if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
        bias[:] = 0.0  # a class may have left numbers that nothing read
    bias[0] += values[0] / actuator.gear[0]
    actuator.biasprm = bias
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE


EFFECT = Effect(
    name="torque_bias",
    summary="A constant torque on a joint, of a cable or a badly zeroed drive.",
    signature=(
        "A constant offset of the joint, that shrinks with the servo's stiffness."
    ),
    confused_with=("joint_offset", "joint_stiffness", "gravity_tilt", "payload"),
    targets=driven_joints,
    parameters=_parameters,
    on_spec=_on_spec,
)
