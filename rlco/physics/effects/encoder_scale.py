"""An encoder, or a gear ratio, with another scale."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter
from rlco.physics.effects.targets import servo_joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("factor", "", 0.5, 2.0, 1.0, (1.03, 0.97)),)


def _on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    commands[:, column] /= values[0]
    return commands


def _on_measurement(positions: Array, column: int, values: Array) -> Array:
    positions = positions.copy()
    positions[..., column] *= values[0]
    return positions


def _on_start(positions: Array, column: int, values: Array) -> Array:
    return _on_measurement(positions, column, 1.0 / values)


EFFECT = Effect(
    name="encoder_scale",
    summary="The encoder tells the joint's angle times a factor.",
    signature="A residual of the whole arm that grows with the joint's angle.",
    confused_with=("actuator_gain", "joint_stiffness", "payload"),
    targets=servo_joints,
    parameters=_parameters,
    on_command=_on_command,
    on_measurement=_on_measurement,
    on_start=_on_start,
)
