"""How soft contacts are: MuJoCo's ``solref`` time constant."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter


def _targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    touching = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    return (None,) if touching.sum() > 1 else ()


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    # MuJoCo holds it at two time steps at least.
    low = 2.0 * float(model.opt.timestep)
    return (Parameter("time_constant", "s", low, 0.2, 0.02, (0.008, 0.05)),)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    for contact in (*spec.geoms, *spec.pairs):
        solref = np.array(contact.solref)
        solref[0] = values[0]
        contact.solref = solref


EFFECT = Effect(
    name="contact_stiffness",
    summary="The time constant in which a contact pushes bodies apart.",
    signature="Bounces of another height, another depth; only along the normal.",
    confused_with=("contact_friction",),
    targets=_targets,
    parameters=_parameters,
    on_spec=_on_spec,
)
