"""A controller that reads its commands more slowly than assumed."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter


def _targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    # A period a few milliseconds off drifts out of step within a recording.
    starts = tuple(float(start) for start in np.arange(2, 26) / 100)
    step = float(model.opt.timestep)
    return (Parameter("period", "s", 0.0, 0.5, 0.0, starts, False, step),)


def _on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    period = float(values[0]) / timestep
    if period <= 1.0:
        return commands
    steps = np.arange(len(commands))
    # Rounding must not read a step early: there the command may be another one.
    read = np.floor(steps / period + 1e-6) * period + 1e-6
    held: Array = commands[np.floor(read).astype(int)]
    return held


EFFECT = Effect(
    name="control_rate",
    summary="Commands are read, and then held, once a period.",
    signature="A staircase: a residual that repeats itself at the controller's rate.",
    confused_with=("command_delay", "actuator_lag"),
    targets=_targets,
    parameters=_parameters,
    on_command=_on_command,
)
