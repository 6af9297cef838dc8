"""The largest torque of an actuator: MuJoCo's ``forcerange``."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, actuators_of
from rlco.physics.effects.targets import actuator_of, driven_joints, holding_torque


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    actuator = actuator_of(model, str(target))
    present = 100.0 * torque
    if model.actuator_forcelimited[actuator]:
        present = float(model.actuator_forcerange[actuator, 1])
    sizes = [part * torque for part in (0.15, 0.3, 0.6, 1.2, 2.5)]
    low = min(0.02 * torque, 0.1 * present)
    starts = tuple(size for size in sizes if size < present) or (0.5 * present,)
    return (Parameter("limit", "N m", low, present, present, starts, False),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    for actuator in actuators_of(spec, target):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = np.array([-values[0], values[0]])


EFFECT = Effect(
    name="torque_limit",
    summary="An actuator gives at most this torque.",
    signature=(
        "A residual only while the command is far or the load large; clipped "
        "acceleration."
    ),
    confused_with=("actuator_gain", "drive_loss", "velocity_limit"),
    targets=driven_joints,
    parameters=_parameters,
    on_spec=_on_spec,
)
