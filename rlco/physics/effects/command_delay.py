"""Commands that arrive late, all by the same time."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter


def _targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("delay", "s", 0.0, 0.4, 0.0, (0.02, 0.08)),)


def _on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    # Between two steps the command is interpolated, so that a fit sees a slope.
    steps = np.arange(len(commands)) - values[0] / timestep
    before = np.floor(steps).astype(int)
    part = (steps - before)[:, None]
    first = commands[np.clip(before, 0, None)]
    second = commands[np.clip(before + 1, 0, len(commands) - 1)]
    return np.asarray((1.0 - part) * first + part * second)


EFFECT = Effect(
    name="command_delay",
    summary="Commands reach the actuators late.",
    signature=(
        "The whole answer is shifted in time: a residual in proportion to the "
        "command's speed."
    ),
    confused_with=("actuator_lag", "control_rate", "viscous_damping", "actuator_gain"),
    targets=_targets,
    parameters=_parameters,
    on_command=_on_command,
)
