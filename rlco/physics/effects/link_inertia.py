"""A link whose mass and inertia are not the model's."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.errors import RlcoError
from rlco.physics.effects.effect import Array, Effect, Parameter, body_of
from rlco.physics.effects.targets import moving_bodies


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (Parameter("factor", "", 0.1, 10.0, 1.0, (1.5, 0.6)),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    body = body_of(spec, target)
    if not body.explicitinertial:
        message = f"body {target!r} has its mass from its geoms: give it an inertial."
        raise RlcoError(message)
    body.mass *= values[0]
    if np.isfinite(body.fullinertia).all():
        body.fullinertia = np.array(body.fullinertia) * values[0]
    else:
        body.inertia = np.array(body.inertia) * values[0]


EFFECT = Effect(
    name="link_inertia",
    summary=(
        "A link's mass and inertia are larger or smaller than the model's, by "
        "one factor."
    ),
    signature=(
        "A torque that turns with the pose on the joints below the link, and inertia."
    ),
    confused_with=("payload", "armature", "actuator_gain"),
    targets=moving_bodies,
    parameters=_parameters,
    on_spec=_on_spec,
)
