"""A free object whose mass is not the model's."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, body_of
from rlco.physics.effects.targets import free_bodies


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("factor", "", 0.05, 20.0, 1.0, (0.5, 2.0, 5.0)),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    body = body_of(spec, target)
    below = [body, *body.find_all("body")]
    for part in below:
        if part.explicitinertial:
            part.mass *= values[0]
            part.inertia = np.array(part.inertia) * values[0]
            part.fullinertia = np.array(part.fullinertia) * values[0]
    for geom in [g for part in below for g in part.geoms]:
        # A geom has a mass of its own, or its volume's times a density.
        geom.mass *= values[0]
        geom.density *= values[0]


EFFECT = Effect(
    name="object_mass",
    summary="The mass and inertia of a free object, times a factor.",
    signature=(
        "More load in lifts, less acceleration in pushes, nothing in free flight."
    ),
    confused_with=("contact_friction", "payload"),
    targets=free_bodies,
    parameters=_parameters,
    on_spec=_on_spec,
)
