"""Play in a transmission: the goal moves only when the play is used up."""

from __future__ import annotations

import mujoco
import numpy as np
from numba import njit

from rlco.physics.effects.effect import Array, Effect, Parameter
from rlco.physics.effects.targets import servo_joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("width", "rad", 0.0, 0.5, 0.0, (0.02, 0.08)),)


@njit(cache=True)
def _play(commands: Array, half: float) -> Array:
    followed = np.empty_like(commands)
    goal = commands[0]
    for step in range(len(commands)):
        goal = min(max(goal, commands[step] - half), commands[step] + half)
        followed[step] = goal
    return followed


def _on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    commands = commands.copy()
    goal = np.ascontiguousarray(commands[:, column])
    commands[:, column] = _play(goal, 0.5 * float(values[0]))
    return commands


EFFECT = Effect(
    name="backlash",
    summary="Play of a given width between a servo and its joint.",
    signature=(
        "A plateau after each reversal, as wide as the play, at any speed and load."
    ),
    confused_with=("coulomb_friction", "stribeck_friction", "load_friction"),
    targets=servo_joints,
    parameters=_parameters,
    on_command=_on_command,
)
