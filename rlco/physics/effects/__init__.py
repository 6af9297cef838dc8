"""The library of physical effects, one module per theme, and their application.

An effect of your own is one `Effect`. `register` adds it, and `load_code` runs a file
that registers some.
"""

from __future__ import annotations

import runpy
from pathlib import Path

from rlco.errors import RlcoError
from rlco.files.own_code import importing
from rlco.physics.effects.actuator import (
    ACTUATOR_GAIN,
    ACTUATOR_LAG,
    DRIVE_LOSS,
    SERVO_DAMPING,
    TORQUE_BIAS,
    TORQUE_LIMIT,
)
from rlco.physics.effects.command import (
    COMMAND_DELAY,
    CONTROL_RATE,
    RANDOM_DELAY,
    VELOCITY_LIMIT,
)
from rlco.physics.effects.contact import CONTACT_FRICTION, CONTACT_STIFFNESS
from rlco.physics.effects.effect import (
    AppliedEffect,
    Effect,
    Evidence,
    Parameter,
    with_units_of_slides,
)
from rlco.physics.effects.friction import (
    COULOMB_FRICTION,
    DIRECTIONAL_FRICTION,
    LOAD_FRICTION,
    STRIBECK_FRICTION,
    VISCOUS_DAMPING,
)
from rlco.physics.effects.inertia import (
    ARMATURE,
    GRAVITY_TILT,
    LINK_INERTIA,
    OBJECT_MASS,
    PAYLOAD,
)
from rlco.physics.effects.link_parameters import (
    LINK_PARAMETERS,
    TORQUE_OFFSET,
    TORQUE_SCALE,
)
from rlco.physics.effects.scene import (
    CONTROLLER_STIFFNESS,
    FIXTURE_FRICTION,
    SCENE_FRICTION,
    SCENE_MASS,
)
from rlco.physics.effects.sensing import ENCODER_SCALE, JOINT_OFFSET
from rlco.physics.effects.step_forces import address_of_law
from rlco.physics.effects.transmission import (
    BACKLASH,
    COGGING,
    HARDENING_SPRING,
    JOINT_COMPLIANCE,
    JOINT_STIFFNESS,
)

# The order in which a search lists effects, and in which they change a model.
_LIBRARY = (
    COULOMB_FRICTION,
    VISCOUS_DAMPING,
    STRIBECK_FRICTION,
    LOAD_FRICTION,
    ARMATURE,
    # Before a payload: what a link holds is no part of its own inertia.
    LINK_PARAMETERS,
    PAYLOAD,
    LINK_INERTIA,
    ACTUATOR_GAIN,
    SERVO_DAMPING,
    ACTUATOR_LAG,
    TORQUE_LIMIT,
    VELOCITY_LIMIT,
    COMMAND_DELAY,
    JOINT_OFFSET,
    ENCODER_SCALE,
    JOINT_STIFFNESS,
    TORQUE_BIAS,
    BACKLASH,
    JOINT_COMPLIANCE,
    GRAVITY_TILT,
    CONTROL_RATE,
    DRIVE_LOSS,
    CONTACT_FRICTION,
    CONTACT_STIFFNESS,
    OBJECT_MASS,
    COGGING,
    HARDENING_SPRING,
    DIRECTIONAL_FRICTION,
    RANDOM_DELAY,
    TORQUE_SCALE,
    TORQUE_OFFSET,
    SCENE_FRICTION,
    SCENE_MASS,
    FIXTURE_FRICTION,
    CONTROLLER_STIFFNESS,
)
EFFECTS: dict[str, Effect] = {
    effect.name: with_units_of_slides(effect) for effect in _LIBRARY
}


def register(effect: Effect) -> None:
    """Add your own effect to the library.

    Raises:
        RlcoError: If its name is taken, its law cannot be compiled, or it is
            `uncommon`: a search knows first values of the library's own alone.
    """
    if effect.name in EFFECTS:
        message = f"an effect named {effect.name!r} exists: give yours another name."
        raise RlcoError(message)
    if effect.uncommon:
        raise RlcoError(
            f"effect {effect.name!r} is uncommon, and no search could begin with it; "
            "leave uncommon=True out, and give its parameters starts."
        )
    for law in (effect.friction, effect.torque):
        if law is not None:
            address_of_law(law)
    EFFECTS[effect.name] = with_units_of_slides(effect)


def searched(evidence: Evidence, *, uncommon: bool = False) -> list[Effect]:
    """Return the effects that a search tries on one kind of recordings.

    Args:
        evidence: The kind of recordings.
        uncommon: Those that are tried only where the others leave something.

    Example:
        >>> [effect.name for effect in searched("flight")]
        ['gravity_tilt', 'contact_friction', 'contact_stiffness', 'object_mass']
        >>> [effect.name for effect in searched("positions", uncommon=True)]
        ['cogging', 'hardening_spring']
    """
    tried = [e for e in EFFECTS.values() if e.candidate and e.uncommon == uncommon]
    return [effect for effect in tried if evidence in effect.shown_by]


# Effects registered by each user file.
_LOADED: dict[Path, set[str]] = {}


def load_code(path: str | Path | None) -> None:
    """Run a Python file that registers effects of your own; run each file only once.

    Args:
        path: The file; None for none.

    Raises:
        RlcoError: If the file does not exist, raises, or registers no effect.
    """
    if path is None:
        return
    file = Path(path).resolve()
    if _LOADED.get(file, {""}) <= EFFECTS.keys():
        return
    if not file.is_file():
        raise RlcoError(
            f"effects code {str(path)!r} is not a file; give a Python file that "
            "registers effects."
        )
    known = set(EFFECTS)
    with importing(f"effects code {str(path)!r}"):
        runpy.run_path(str(file))
    added = EFFECTS.keys() - known
    if not added:
        raise RlcoError(
            f"effects code {str(path)!r} registers no effect; call register(Effect)."
        )
    _LOADED[file] = added


__all__ = [
    "EFFECTS",
    "AppliedEffect",
    "Effect",
    "Parameter",
    "load_code",
    "register",
    "searched",
]
