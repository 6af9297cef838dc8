"""A base that does not stand level."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter


def _targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    starts = (0.03,)
    return tuple(
        Parameter(axis, "rad", -0.5, 0.5, 0.0, starts) for axis in ("roll", "pitch")
    )


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    size = float(np.linalg.norm(spec.option.gravity))
    roll, pitch = values
    down = np.array([np.sin(pitch), -np.sin(roll), 0.0])
    down[2] = -np.cos(np.hypot(roll, pitch))
    spec.option.gravity = size * down / np.linalg.norm(down)


EFFECT = Effect(
    name="gravity_tilt",
    summary="The robot's base is tilted: gravity does not point along its -z.",
    signature=(
        "A static torque on all joints at once, that turns with the first joint."
    ),
    confused_with=("torque_bias", "payload", "joint_offset"),
    targets=_targets,
    parameters=_parameters,
    on_spec=_on_spec,
)
