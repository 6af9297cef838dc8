"""Contact between bodies: friction and stiffness."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.effects.effect import Array, Effect, Parameter, Present

_LEAST = 0.01


def _contact_friction_targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,) if _touch(model).sum() > 1 else ()


def _contact_friction_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    starts = (0.05, 0.1, 0.2, 0.4, 0.8)
    free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    ours = np.isin(model.body_rootid[model.geom_bodyid], model.body_rootid[free])
    known = model.geom_friction[:, 0]
    usual = _usual(known[_touch(model) & ours], known[_touch(model)])
    size = ("friction", "", _LEAST, 3.0, usual, starts)
    return (Parameter(*size, present=Present(usual)),)


def _touch(model: mujoco.MjModel) -> NDArray[np.bool_]:
    return np.asarray((model.geom_contype > 0) | (model.geom_conaffinity > 0))


def _usual(objects: Iterable[float], everything: Iterable[float]) -> float:
    """Return the coefficient of the free objects, or of all that can touch."""
    known = [*objects] or [*everything]
    return max(float(np.median(known)), _LEAST) if known else 1.0


def _contact_friction_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    touching = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
    objects = [
        geom.friction[0]
        for body in spec.bodies
        if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)
        for part in [body, *body.find_all("body")]
        for geom in part.geoms
        if geom.contype or geom.conaffinity
    ]
    # All scale together: one coefficient for soft pads and a hard table would be a
    # change, even if it is the one that the objects have already.
    factor = values[0] / _usual(objects, [geom.friction[0] for geom in touching])
    for geom in spec.geoms:
        friction = np.array(geom.friction)
        friction[0] *= factor
        geom.friction = friction
    for pair in spec.pairs:
        friction = np.array(pair.friction)
        friction[:2] *= factor
        pair.friction = friction


CONTACT_FRICTION = Effect(
    name="contact_friction",
    summary=(
        "The coefficient of sliding friction of the free objects, and that of all "
        "else in proportion."
    ),
    signature=(
        "Too long or short a slide after a push or an impact; nothing in free flight."
    ),
    confused_with=("object_mass", "contact_stiffness"),
    targets=_contact_friction_targets,
    parameters=_contact_friction_parameters,
    on_spec=_contact_friction_on_spec,
    shown_by=("positions", "task", "flight"),
    by_hand="Push the object at two speeds, and let it slide freely.",
)


def _contact_stiffness_targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    touching = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    return (None,) if touching.sum() > 1 else ()


def _contact_stiffness_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    # MuJoCo limits it to at least two time steps.
    low = 2.0 * float(model.opt.timestep)
    return (Parameter("time_constant", "s", low, 0.2, 0.02, (0.008, 0.05)),)


def _contact_stiffness_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    for contact in (*spec.geoms, *spec.pairs):
        solref = np.array(contact.solref)
        solref[0] = values[0]
        contact.solref = solref


CONTACT_STIFFNESS = Effect(
    name="contact_stiffness",
    summary="The time constant in which a contact pushes bodies apart.",
    signature="Bounces of another height, another depth; only along the normal.",
    confused_with=("contact_friction",),
    targets=_contact_stiffness_targets,
    parameters=_contact_stiffness_parameters,
    on_spec=_contact_stiffness_on_spec,
    shown_by=("positions", "task", "flight"),
    by_hand="Drop the object from two heights.",
)
