"""Something held: a point mass at the last link."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, body_of
from rlco.physics.effects.targets import last_links

# A sphere of 2 cm: what it turns about itself is small beside its distance from joints.
_RADIUS = 0.02


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    moving = float(model.body_mass[1:].sum())
    starts = (0.03 * moving, 0.15 * moving)
    mass = Parameter("mass", "kg", 0.0, 2.0 * moving, 0.0, starts)
    place = [Parameter(axis, "m", -0.25, 0.25, 0.0, (0.0,)) for axis in "xyz"]
    return (mass, *place)


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    mass = max(float(values[0]), 0.0)
    if mass < 1e-9:
        return
    held = body_of(spec, target).add_body(pos=values[1:4])
    held.mass = mass
    # Left out, MuJoCo puts the centre at `pos` once more.
    held.ipos = np.zeros(3)
    held.inertia = np.full(3, 0.4 * mass * _RADIUS**2)
    held.explicitinertial = True


EFFECT = Effect(
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
    parameters=_parameters,
    on_spec=_on_spec,
)
