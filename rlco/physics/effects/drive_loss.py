"""A drive that loses torque the more it gives."""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Array, Effect, Parameter, StepTerms
from rlco.physics.effects.targets import driven_joints, holding_torque


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    scale = 1.0 / holding_torque(model, str(target))
    starts = (0.1 * scale, 0.4 * scale)
    return (Parameter("loss", "1/(N m)", 0.0, 20.0 * scale, 0.0, starts),)


def _on_step(terms: StepTerms, dof: int, actuator: int, values: Array) -> None:
    terms.drive[actuator] = values[0]


EFFECT = Effect(
    name="drive_loss",
    summary=(
        "An actuator's torque T becomes T / (1 + loss |T|), by supply, "
        "resistance or heat."
    ),
    signature="Too little torque where much is asked for, without a sharp limit.",
    confused_with=("torque_limit", "actuator_gain"),
    targets=driven_joints,
    parameters=_parameters,
    on_step=_on_step,
)
