"""Path of commands: delay, read period and velocity limit."""

from __future__ import annotations

import mujoco
import numpy as np
from numba import njit

from rlco.physics.effects.effect import Array, ControllerTiming, Effect, Parameter
from rlco.physics.effects.targets import servo_joints


def _command_delay_targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _command_delay_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("delay", "s", 0.0, 0.4, 0.0, (0.02, 0.08)),)


def _command_delay_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    # Interpolating between steps gives a fit a gradient.
    steps = np.arange(len(commands)) - values[0] / timestep
    before = np.floor(steps).astype(int)
    part = (steps - before)[:, None]
    first = commands[np.clip(before, 0, None)]
    second = commands[np.clip(before + 1, 0, len(commands) - 1)]
    return np.asarray((1.0 - part) * first + part * second)


def _command_delay_on_controller(
    timing: ControllerTiming, actuator: int, timestep: float, values: Array
) -> None:
    timing.delay += float(values[0])


COMMAND_DELAY = Effect(
    name="command_delay",
    summary="Commands reach the actuators late.",
    signature=(
        "The whole answer is shifted in time: a residual in proportion to the "
        "command's speed."
    ),
    confused_with=("actuator_lag", "control_rate", "viscous_damping", "actuator_gain"),
    targets=_command_delay_targets,
    parameters=_command_delay_parameters,
    on_command=_command_delay_on_command,
    on_controller=_command_delay_on_controller,
    order=20,
)


def _control_rate_targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _control_rate_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    # A period a few milliseconds off gets out of phase within a recording.
    starts = tuple(float(start) for start in np.arange(2, 26) / 100)
    step = float(model.opt.timestep)
    return (Parameter("period", "s", 0.0, 0.5, 0.0, starts, False, step),)


def _control_rate_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    period = float(values[0]) / timestep
    if period <= 1.0:
        return commands
    steps = np.arange(len(commands))
    # Rounding must not read a step early, where the command may be another one.
    read = np.floor(steps / period + 1e-6) * period + 1e-6
    held: Array = commands[np.floor(read).astype(int)]
    return held


def _control_rate_on_controller(
    timing: ControllerTiming, actuator: int, timestep: float, values: Array
) -> None:
    timing.period += float(values[0])


CONTROL_RATE = Effect(
    name="control_rate",
    summary="Commands are read, and then held, once a period.",
    signature="A staircase: a residual that repeats itself at the controller's rate.",
    confused_with=("command_delay", "actuator_lag"),
    targets=_control_rate_targets,
    parameters=_control_rate_parameters,
    on_command=_control_rate_on_command,
    on_controller=_control_rate_on_controller,
    order=10,
    shown_by=("positions", "servo", "task"),
)


def _velocity_limit_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    starts = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
    return (Parameter("limit", "rad/s", 0.02, 20.0, 20.0, starts, False),)


@njit(cache=True)
def _follow(commands: Array, largest: float) -> Array:
    followed = np.empty_like(commands)
    goal = commands[0]
    for step in range(len(commands)):
        change = commands[step] - goal
        goal += min(max(change, -largest), largest)
        followed[step] = goal
    return followed


def _velocity_limit_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    goal = np.ascontiguousarray(commands[:, column])
    commands[:, column] = _follow(goal, float(values[0]) * timestep)
    return commands


VELOCITY_LIMIT = Effect(
    name="velocity_limit",
    summary="A servo's internal goal moves at most at this speed.",
    signature="Steps are answered by ramps of one slope.",
    confused_with=("torque_limit", "actuator_lag"),
    targets=servo_joints,
    parameters=_velocity_limit_parameters,
    on_command=_velocity_limit_on_command,
    order=30,
    shown_by=("positions", "servo"),
)
