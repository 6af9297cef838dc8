"""An actuator that follows its command as a low-pass filter."""

from __future__ import annotations

import math

import mujoco
from scipy.signal import lfilter

from rlco.physics.effects.effect import Array, Effect, Parameter
from rlco.physics.effects.targets import driven_joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("time_constant", "s", 0.0, 1.0, 0.0, (0.02, 0.1)),)


def lag_part(time_constant: float, timestep: float) -> float:
    """Return the part of the distance to its command that an actuator goes in a step.

    That of the exact solution, as MuJoCo's ``filterexact``: dividing the step by the
    time constant would make it half a step longer.

    Example:
        >>> lag_part(0.02, 0.0), lag_part(0.0, 0.002)
        (0.0, 1.0)
        >>> round((1.0 - lag_part(0.02, 0.002)) ** 10, 6)  # after 20 ms
        0.367879
    """
    return -math.expm1(-timestep / time_constant) if time_constant > 0.0 else 1.0


def _on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    part = lag_part(float(values[0]), timestep)
    first = commands[0, column]
    filtered = lfilter([part], [1.0, part - 1.0], commands[:, column] - first)
    commands[:, column] = filtered + first
    return commands


EFFECT = Effect(
    name="actuator_lag",
    summary="An actuator follows its command through a first-order low-pass filter.",
    signature="Amplitude falls and lags more the faster the command moves.",
    confused_with=("command_delay", "viscous_damping", "armature", "velocity_limit"),
    targets=driven_joints,
    parameters=_parameters,
    on_command=_on_command,
)
