"""An actuator whose goal moves no faster than a limit."""

from __future__ import annotations

import mujoco
import numpy as np
from numba import njit

from rlco.physics.effects.effect import Array, Effect, Parameter
from rlco.physics.effects.targets import servo_joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
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


def _on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    goal = np.ascontiguousarray(commands[:, column])
    commands[:, column] = _follow(goal, float(values[0]) * timestep)
    return commands


EFFECT = Effect(
    name="velocity_limit",
    summary="A servo's internal goal moves at most at this speed.",
    signature="Steps are answered by ramps of one slope.",
    confused_with=("torque_limit", "actuator_lag"),
    targets=servo_joints,
    parameters=_parameters,
    on_command=_on_command,
)
