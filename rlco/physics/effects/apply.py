"""Applying effects to a model, to commands, to measurements and to each physics step.

Several effects act at once, in an order that does not depend on how they are listed.
A command is read by the controller (`control_rate`), travels (`command_delay`) and
becomes a joint's goal (`velocity_limit`, `backlash`, `actuator_lag`), which the servo
compares with what the encoder tells (`joint_offset`, `encoder_scale`). A measurement
takes the encoder's part of that way back. Changes of a model come in the library's
order, and effects of a user's own after those of the library.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.effects import EFFECTS, AppliedEffect, Effect, StepTerms
from rlco.physics.effects.effect import Array
from rlco.physics.effects.targets import (
    actuator_of,
    dof_of,
    driven_joints,
    moving_bodies,
    servo_joints,
)

COMMAND_ORDER = (
    "control_rate",
    "command_delay",
    "velocity_limit",
    "backlash",
    "actuator_lag",
    "joint_offset",
    "encoder_scale",
)


class EffectError(RlcoError):
    """An effect that cannot be applied.

    Example:
        >>> print(EffectError("backlash", "joint4", "a motor has no goal", "give kp"))
        effect 'backlash' at 'joint4' cannot be applied: a motor has no goal; give kp.
    """

    def __init__(self, name: str, target: str | None, reason: str, advice: str) -> None:
        place = f" at {target!r}" if target is not None else ""
        super().__init__(
            f"effect {name!r}{place} cannot be applied: {reason}; {advice}."
        )


def library_effect(name: str) -> Effect:
    """Return the effect of that name.

    Raises:
        UnknownNameError: If there is none.
    """
    if name not in EFFECTS:
        raise UnknownNameError("effect", name, sorted(EFFECTS))
    return EFFECTS[name]


def checked(
    model: mujoco.MjModel, effect: AppliedEffect, *, controlled: bool = False
) -> AppliedEffect:
    """Return an effect with its numbers in the library's order.

    Args:
        model: The model without the effect.
        effect: Its target is a name in the model.
        controlled: Whether a simulated controller reads the encoders, so that they
            may tell wrong positions of joints that motors drive.

    Raises:
        UnknownNameError: If there is no such effect.
        EffectError: If the model has no such target, or numbers are missing, unknown
            or not finite.
    """
    known = library_effect(effect.name)
    allowed = known.targets(model)
    # A payload may hang at any link, not only where a search would look for it.
    links = moving_bodies(model)
    more = links if set(allowed) & set(links) else ()
    if controlled and known.on_measurement is not None:
        more = driven_joints(model)
    if effect.target not in (*allowed, *more):
        raise EffectError(effect.name, effect.target, *_why_not(model, effect, allowed))
    names = [p.name for p in known.parameters(model, effect.target)]
    if set(names) != set(effect.parameters):
        given = ", ".join(effect.parameters) or "none"
        raise EffectError(
            effect.name,
            effect.target,
            f"its parameters are {', '.join(names)}, and given were {given}",
            "give each of them a number",
        )
    for name, value in effect.parameters.items():
        if not np.isfinite(value):
            raise EffectError(
                effect.name, effect.target, f"{name} is {value}", "give a finite number"
            )
    return replace(effect, parameters={n: float(effect.parameters[n]) for n in names})


def in_order(effects: Iterable[AppliedEffect]) -> list[AppliedEffect]:
    """Return effects in the library's order, those of a user's own at the end."""
    names = list(EFFECTS)
    return sorted(effects, key=lambda effect: names.index(effect.name))


def apply_to_spec(spec: mujoco.MjSpec, effects: Iterable[AppliedEffect]) -> None:
    """Change a model, before it is compiled, by what MJCF can say of the effects.

    Raises:
        RlcoError: If a target is not there.

    Example:
        >>> xml = "<mujoco><worldbody><body><joint name='j' damping='2'/>"
        >>> xml += "<geom size='1'/></body></worldbody></mujoco>"
        >>> spec = mujoco.MjSpec.from_string(xml)
        >>> apply_to_spec(spec, [AppliedEffect("viscous_damping", "j", {"damping": 3})])
        >>> float(spec.compile().dof_damping[0])
        5.0
    """
    for effect in in_order(effects):
        change = library_effect(effect.name).on_spec
        if change is not None:
            change(spec, effect.target, effect.values)


def apply_to_commands(
    commands: Array, model: mujoco.MjModel, effects: Iterable[AppliedEffect]
) -> Array:
    """Return commands as the actuators get them.

    Args:
        commands: What was sent, one row a physics step, (steps, actuators).
        model: The model that they drive.
        effects: Those that act.
    """
    for effect in sorted(in_order(effects), key=_place):
        change = library_effect(effect.name).on_command
        if change is None:
            continue
        column = None if effect.target is None else actuator_of(model, effect.target)
        commands = change(commands, column, model.opt.timestep, effect.values)
    return commands


def apply_to_measurement(
    positions: Array, joints: Sequence[str], effects: Iterable[AppliedEffect]
) -> Array:
    """Return joint positions as the encoders tell them.

    Args:
        positions: True positions, (..., joints), [rad or m].
        joints: Names of the columns.
        effects: Those that act; what is told of other joints is left out.

    Example:
        >>> scale = AppliedEffect("encoder_scale", "j", {"factor": 1.1})
        >>> shift = AppliedEffect("joint_offset", "j", {"offset": 0.5})
        >>> told = apply_to_measurement(np.array([2.0]), ["j"], [shift, scale])
        >>> told.round(6).tolist(), true_from_told(told, ["j"], [scale, shift]).tolist()
        ([2.7], [2.0])
    """
    for effect in sorted(in_order(effects), key=_place)[::-1]:
        change = library_effect(effect.name).on_measurement
        if change is not None and effect.target in joints:
            positions = change(positions, joints.index(effect.target), effect.values)
    return positions


def true_from_told(
    positions: Array, joints: Sequence[str], effects: Iterable[AppliedEffect]
) -> Array:
    """Return the true joint positions: the inverse of `apply_to_measurement`."""
    for effect in sorted(in_order(effects), key=_place):
        change = library_effect(effect.name).on_start
        if change is not None and effect.target in joints:
            positions = change(positions, joints.index(effect.target), effect.values)
    return positions


def step_terms(model: mujoco.MjModel, effects: Iterable[AppliedEffect]) -> StepTerms:
    """Return what acts at each physics step of a model."""
    terms = StepTerms.none(model)
    for effect in in_order(effects):
        write = library_effect(effect.name).on_step
        if write is not None:
            joint = str(effect.target)
            write(terms, dof_of(model, joint), actuator_of(model, joint), effect.values)
    return terms


def _place(effect: AppliedEffect) -> int:
    if effect.name in COMMAND_ORDER:
        return COMMAND_ORDER.index(effect.name)
    return len(COMMAND_ORDER)


def _why_not(
    model: mujoco.MjModel, effect: AppliedEffect, allowed: tuple[str | None, ...]
) -> tuple[str, str]:
    """Return why a target is not allowed, and what to do."""
    if allowed == (None,):
        return "it acts on the whole robot", "give no target"
    servos = set(allowed) == set(servo_joints(model))
    if servos and effect.target in driven_joints(model):
        return (
            "its actuator is a motor, which is commanded by a torque and not by a goal",
            "leave it out, or give a model with position actuators",
        )
    if not allowed:
        return "the model has nothing that it acts on", "leave it out"
    names = ", ".join(str(name) for name in allowed)
    return "the model has no such target", f"it can act on {names}"
