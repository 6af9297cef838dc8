"""An encoder that does not read zero at zero."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter
from rlco.physics.effects.targets import servo_joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("offset", "rad", -0.3, 0.3, 0.0, (0.01, -0.01)),)


def _on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    # The servo pulls what the encoder tells, not the joint itself, to the command.
    commands[:, column] -= values[0]
    return commands


def _on_measurement(positions: Array, column: int, values: Array) -> Array:
    positions = positions.copy()
    positions[..., column] += values[0]
    return positions


def _on_start(positions: Array, column: int, values: Array) -> Array:
    return _on_measurement(positions, column, -values)


EFFECT = Effect(
    name="joint_offset",
    summary="The encoder tells the joint's angle plus a constant.",
    signature=(
        "A small offset that goes with the change of gravity's torque, not with "
        "stiffness."
    ),
    confused_with=("torque_bias", "gravity_tilt", "payload"),
    targets=servo_joints,
    parameters=_parameters,
    on_command=_on_command,
    on_measurement=_on_measurement,
    on_start=_on_start,
)
