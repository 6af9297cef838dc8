"""Sliding friction between bodies that touch."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter


def _targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    touching = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    return (None,) if touching.sum() > 1 else ()


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    starts = (0.05, 0.1, 0.2, 0.4, 0.8)
    return (Parameter("friction", "", 0.01, 3.0, 1.0, starts),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    for geom in spec.geoms:
        friction = np.array(geom.friction)
        friction[0] = values[0]
        geom.friction = friction
    for pair in spec.pairs:
        friction = np.array(pair.friction)
        friction[:2] = values[0]
        pair.friction = friction


EFFECT = Effect(
    name="contact_friction",
    summary="The coefficient of sliding friction of all contacts.",
    signature=(
        "Too long or short a slide after a push or an impact; nothing in free flight."
    ),
    confused_with=("object_mass", "contact_stiffness"),
    targets=_targets,
    parameters=_parameters,
    on_spec=_on_spec,
)
