"""The library of physical effects, one module each, and how they are applied.

An effect of your own is one module with an `EFFECT` in it; `register` makes it known.
"""

from __future__ import annotations

from rlco.errors import RlcoError
from rlco.physics.effects import (
    actuator_gain,
    actuator_lag,
    armature,
    backlash,
    command_delay,
    contact_friction,
    contact_stiffness,
    control_rate,
    coulomb_friction,
    drive_loss,
    encoder_scale,
    gravity_tilt,
    joint_compliance,
    joint_offset,
    joint_stiffness,
    link_inertia,
    load_friction,
    object_mass,
    payload,
    stribeck_friction,
    torque_bias,
    torque_limit,
    velocity_limit,
    viscous_damping,
)
from rlco.physics.effects.effect import (
    AppliedEffect,
    Effect,
    Parameter,
    StepTerms,
)

_MODULES = (
    coulomb_friction,
    viscous_damping,
    stribeck_friction,
    load_friction,
    armature,
    payload,
    link_inertia,
    actuator_gain,
    actuator_lag,
    torque_limit,
    velocity_limit,
    command_delay,
    joint_offset,
    encoder_scale,
    joint_stiffness,
    torque_bias,
    backlash,
    joint_compliance,
    gravity_tilt,
    control_rate,
    drive_loss,
    contact_friction,
    contact_stiffness,
    object_mass,
)
EFFECTS: dict[str, Effect] = {module.EFFECT.name: module.EFFECT for module in _MODULES}


def register(effect: Effect) -> None:
    """Add an effect of your own to the library.

    Raises:
        RlcoError: If one of that name is known.
    """
    if effect.name in EFFECTS:
        message = f"an effect named {effect.name!r} exists: give yours another name."
        raise RlcoError(message)
    EFFECTS[effect.name] = effect


__all__ = [
    "EFFECTS",
    "AppliedEffect",
    "Effect",
    "Parameter",
    "StepTerms",
    "register",
]
