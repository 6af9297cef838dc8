"""Encoder reports: offsets and factors."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter
from rlco.physics.effects.targets import servo_joints


def _joint_offset_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("offset", "rad", -0.3, 0.3, 0.0, (0.01, -0.01)),)


def _joint_offset_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    # The servo drives the encoder's report, not the joint itself, to the command.
    commands[:, column] -= values[0]
    return commands


def _joint_offset_on_measurement(positions: Array, column: int, values: Array) -> Array:
    positions = positions.copy()
    positions[..., column] += values[0]
    return positions


def _joint_offset_on_start(positions: Array, column: int, values: Array) -> Array:
    return _joint_offset_on_measurement(positions, column, -values)


JOINT_OFFSET = Effect(
    name="joint_offset",
    summary="The encoder reports the joint's angle plus a constant.",
    signature=(
        "A small offset that goes with the change of gravity's torque, not with "
        "stiffness."
    ),
    confused_with=("torque_bias", "gravity_tilt", "payload"),
    targets=servo_joints,
    parameters=_joint_offset_parameters,
    on_command=_joint_offset_on_command,
    on_measurement=_joint_offset_on_measurement,
    on_start=_joint_offset_on_start,
    order=60,
)


def _encoder_scale_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("factor", "", 0.5, 2.0, 1.0, (1.03, 0.97)),)


def _encoder_scale_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    commands[:, column] /= values[0]
    return commands


def _encoder_scale_on_measurement(
    positions: Array, column: int, values: Array
) -> Array:
    positions = positions.copy()
    positions[..., column] *= values[0]
    return positions


def _encoder_scale_on_start(positions: Array, column: int, values: Array) -> Array:
    return _encoder_scale_on_measurement(positions, column, 1.0 / values)


ENCODER_SCALE = Effect(
    name="encoder_scale",
    summary="The encoder reports the joint's angle times a factor.",
    signature="A residual of the whole arm that grows with the joint's angle.",
    confused_with=("actuator_gain", "joint_stiffness", "payload"),
    targets=servo_joints,
    parameters=_encoder_scale_parameters,
    on_command=_encoder_scale_on_command,
    on_measurement=_encoder_scale_on_measurement,
    on_start=_encoder_scale_on_start,
    order=70,
)
