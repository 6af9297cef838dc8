"""Masses and inertias of motors, links, payloads and objects; direction of gravity."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.errors import RlcoError
from rlco.physics.effects.effect import (
    Array,
    Effect,
    Parameter,
    Present,
    body_of,
    joint_of,
)
from rlco.physics.effects.targets import (
    dof_of,
    free_bodies,
    holding_torque,
    joints,
    last_links,
    moving_bodies,
)


def _armature_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    present = float(model.dof_armature[dof_of(model, str(target))])
    scale = max(present, 0.01 * holding_torque(model, str(target)), 1e-4)
    starts = (scale, 4.0 * scale, -0.4 * present)
    size = ("armature", "kg m^2", -0.95 * present, 200 * scale, 0.0, starts)
    return (Parameter(*size, present=Present(present)),)


def _armature_on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    joint_of(spec, target).armature += values[0]


ARMATURE = Effect(
    name="armature",
    summary=(
        "Inertia that a joint's motor adds, by its rotor and the square of its gear."
    ),
    signature="A residual in phase with acceleration, overshoot, nothing in holds.",
    confused_with=("link_inertia", "payload", "actuator_lag"),
    targets=joints,
    parameters=_armature_parameters,
    on_spec=_armature_on_spec,
    tolerances=("armature",),
)


_BY_HAND = "Repeat one motion with a known weight in the hand, and without it."
# A sphere of 2 cm: its own inertia is small compared with its distance from joints.
_RADIUS = 0.02
# Where a payload's centre may lie: about a hand's frame, and beyond a long link's end.
_HAND, _BEYOND = 0.25, 0.1  # [m]


def _payload_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    moving = _moving_mass(model, str(target))
    starts = (0.03 * moving, 0.15 * moving)
    mass = Parameter("mass", "kg", 0.0, 2.0 * moving, 0.0, starts)
    far = max(_HAND, _reach(model, str(target)) + _BEYOND)
    place = [Parameter(axis, "m", -far, far, 0.0, (0.0,)) for axis in "xyz"]
    return (mass, *place)


def _moving_mass(model: mujoco.MjModel, body: str) -> float:
    """Return the mass of a robot without what stands still, such as its table [kg]."""
    tree = model.body_rootid == model.body_rootid[model.body(body).id]
    return float(model.body_mass[tree & (model.body_weldid > 0)].sum())


def _reach(model: mujoco.MjModel, body: str) -> float:
    """Return how far a link extends from its frame [m], a rod of its inertia."""
    link = model.body(body)
    thickness = 3.0 * float(link.inertia.max()) / max(float(link.mass[0]), 1e-9)
    return float(np.linalg.norm(link.ipos) + np.sqrt(thickness))


def _payload_on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    mass = max(float(values[0]), 0.0)
    if mass < 1e-9:
        return
    held = body_of(spec, target).add_body(pos=values[1:4])
    held.mass = mass
    # Otherwise MuJoCo would add `pos` to the centre again.
    held.ipos = np.zeros(3)
    held.inertia = np.full(3, 0.4 * mass * _RADIUS**2)
    held.explicitinertial = True


PAYLOAD = Effect(
    name="payload",
    summary=(
        "A mass held at the last link, with its centre at x, y, z in that link's frame."
    ),
    signature=(
        "A torque that turns with the pose on all joints below the hand, and inertia."
    ),
    confused_with=(
        "link_inertia",
        "armature",
        "actuator_gain",
        "gravity_tilt",
        "torque_bias",
    ),
    targets=last_links,
    parameters=_payload_parameters,
    on_spec=_payload_on_spec,
    shown_by=("positions", "torques", "task"),
    held=True,
    tolerances=("mass", "inertia"),
    by_hand=_BY_HAND,
)


def _link_inertia_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    present = Present(float(model.body(str(target)).mass[0]), "mass", "kg")
    return (Parameter("factor", "", 0.1, 10.0, 1.0, (1.5, 0.6), present=present),)


def _link_inertia_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    body = body_of(spec, target)
    if not body.explicitinertial:
        message = f"body {target!r} has its mass from its geoms: give it an inertial."
        raise RlcoError(message)
    body.mass *= values[0]
    if np.isfinite(body.fullinertia).all():
        body.fullinertia = np.array(body.fullinertia) * values[0]
    else:
        body.inertia = np.array(body.inertia) * values[0]


LINK_INERTIA = Effect(
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
    parameters=_link_inertia_parameters,
    on_spec=_link_inertia_on_spec,
    tolerances=("mass", "inertia"),
    by_hand=_BY_HAND,
)


def _object_mass_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    present = Present(float(model.body(str(target)).subtreemass[0]), "mass", "kg")
    return (Parameter("factor", "", 0.05, 20.0, 1.0, (0.5, 2.0, 5.0), present=present),)


def _object_mass_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    body = body_of(spec, target)
    below = [body, *body.find_all("body")]
    for part in below:
        if part.explicitinertial:
            part.mass *= values[0]
            part.inertia = np.array(part.inertia) * values[0]
            part.fullinertia = np.array(part.fullinertia) * values[0]
    for geom in [g for part in below for g in part.geoms]:
        # A geom has a mass of its own, or a density.
        geom.mass *= values[0]
        geom.density *= values[0]


OBJECT_MASS = Effect(
    name="object_mass",
    summary="The mass and inertia of a free object, times a factor.",
    signature=(
        "More load in lifts, less acceleration in pushes, nothing in free flight."
    ),
    confused_with=("contact_friction", "payload"),
    targets=free_bodies,
    parameters=_object_mass_parameters,
    on_spec=_object_mass_on_spec,
    shown_by=("positions", "task", "flight"),
    by_hand="Lift the object, hold it for 2 s, and push it.",
)


def _gravity_tilt_targets(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return (None,)


def _gravity_tilt_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    starts = (0.03,)
    return tuple(
        Parameter(axis, "rad", -0.5, 0.5, 0.0, starts) for axis in ("roll", "pitch")
    )


def _gravity_tilt_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    size = float(np.linalg.norm(spec.option.gravity))
    roll, pitch = values
    down = np.array([np.sin(pitch), -np.sin(roll), 0.0])
    down[2] = -np.cos(np.hypot(roll, pitch))
    spec.option.gravity = size * down / np.linalg.norm(down)


GRAVITY_TILT = Effect(
    name="gravity_tilt",
    summary="The robot's base is tilted: gravity does not point along its -z.",
    signature=(
        "A static torque on all joints at once, that turns with the first joint."
    ),
    confused_with=("torque_bias", "payload", "joint_offset"),
    targets=_gravity_tilt_targets,
    parameters=_gravity_tilt_parameters,
    on_spec=_gravity_tilt_on_spec,
    shown_by=("positions", "torques", "servo", "task", "flight"),
)
