"""Apply effects to a model, to commands, to measurements and to each physics step.

Several effects may act at once, in an order that does not depend on how they are
listed. A command is read by the controller (`control_rate`), travels (`command_delay`,
`random_delay`) and becomes a joint's goal (`velocity_limit`, `backlash`,
`actuator_lag`), which the servo compares with the encoder's report (`joint_offset`,
`encoder_scale`). Each effect declares its position on this path. A measurement inverts
the encoder's part. Changes of a model follow the library's order, with user-defined
effects last.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from rlco.errors import RlcoError, UnknownNameError
from rlco.files.reading import reason
from rlco.physics.effects import EFFECTS, AppliedEffect, Effect
from rlco.physics.effects.effect import Array, ControllerTiming, Parameter, joint_of
from rlco.physics.effects.scene import FACTOR
from rlco.physics.effects.step_forces import LawAt, StepForces, table_of
from rlco.physics.effects.targets import (
    ONE_AXIS,
    actuator_of,
    command_at,
    dof_of,
    driven_joints,
    joints,
    moving_bodies,
    qpos_address,
    servo_joints,
)

# MuJoCo creates a friction constraint only where the friction is above zero.
_LEAST_FRICTION = 1e-9


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
    """Return an effect with its parameters in the library's order.

    Args:
        model: The model without the effect.
        effect: Its target is a name in the model.
        controlled: Whether a simulated controller reads the encoders, which may then
            report wrong positions of joints driven by motors.

    Raises:
        UnknownNameError: If there is no such effect.
        EffectError: If the model has no such target, parameters are missing, unknown
            or not finite, one is too large or small for any robot or would take away
            more than the model has, or the effect cannot have them.
    """
    known = library_effect(effect.name)
    allowed = known.targets(model)
    # A payload may be at any link, not only where a search would place it.
    links = moving_bodies(model)
    more = links if set(allowed) & set(links) else ()
    if controlled and known.on_measurement is not None:
        more = driven_joints(model)
    if effect.target not in (*allowed, *more):
        raise EffectError(effect.name, effect.target, *_refusal(model, effect, allowed))
    parameters = known.parameters(model, effect.target)
    names = [p.name for p in parameters]
    if set(names) != set(effect.parameters):
        given = ", ".join(effect.parameters) or "none"
        raise EffectError(
            effect.name,
            effect.target,
            f"its parameters are {', '.join(names)}, given: {given}",
            "give a number for each of them",
        )
    for name, value in effect.parameters.items():
        if not np.isfinite(value):
            raise EffectError(
                effect.name, effect.target, f"{name} is {value}", "give a finite number"
            )
    for parameter in parameters:
        why = _impossible(parameter, effect.parameters[parameter.name])
        if why is not None:
            raise EffectError(effect.name, effect.target, *why)
    found = replace(effect, parameters={n: float(effect.parameters[n]) for n in names})
    if known.refuse is not None and (why := known.refuse(found.values)) is not None:
        raise EffectError(effect.name, effect.target, *why)
    return found


def _impossible(parameter: Parameter, value: float) -> tuple[str, str] | None:
    """Return why no robot has a value of a parameter, and what to do; None if one may.

    Bounds of a search are no bounds of what may be given, but for their sign: what is
    searched from 0 upwards is never below.
    """
    given = f"{parameter.name}={value:g} {parameter.unit}".rstrip()
    if abs(value) > parameter.largest:
        largest = f"{parameter.largest:g} {parameter.unit}".rstrip()
        return f"{given} is beyond {largest}", "give a smaller number"
    if parameter.present is None:
        low = parameter.low
        if value < 0.0 <= low or value == 0.0 < low:
            advice = "give a number above 0" if low > 0.0 else "give 0 or more"
            return f"{given} cannot be so small", advice
    elif parameter.after(value) < 0.0:
        # What a model has may become less, as far as there is some.
        left = f"would leave the model with {parameter.after(value):g}, less than none"
        return f"{parameter.name}={value:g} {left}", "give a larger number"
    return None


def check_of_task(effect: AppliedEffect) -> None:
    """Refuse an effect on a task's construction unless it is a positive factor.

    Raises:
        EffectError: If it has a target, or parameters other than a positive factor.
    """
    factor = effect.parameters.get("factor", 0.0)
    if effect.target is not None:
        reason, advice = "it acts on the whole scene", "give no target"
    elif set(effect.parameters) != {"factor"}:
        given = ", ".join(effect.parameters) or "none"
        reason = f"its only parameter is factor, given: {given}"
        advice = "give it a number"
    elif not 0.0 < factor <= FACTOR.largest:
        reason = f"factor is {factor:g}"
        advice = f"give a number above 0, of at most {FACTOR.largest:g}"
    else:
        return
    raise EffectError(effect.name, effect.target, reason, advice)


def in_order(effects: Iterable[AppliedEffect]) -> list[AppliedEffect]:
    """Return effects in the library's order, with user-defined ones at the end."""
    names = list(EFFECTS)
    return sorted(effects, key=lambda effect: names.index(effect.name))


def apply_to_spec(spec: mujoco.MjSpec, effects: Iterable[AppliedEffect]) -> None:
    """Apply the effects that MJCF can express to a model before it is compiled.

    Raises:
        RlcoError: If a target does not exist.

    Example:
        >>> xml = "<mujoco><worldbody><body><joint name='j' damping='2'/>"
        >>> xml += "<geom size='1'/></body></worldbody></mujoco>"
        >>> spec = mujoco.MjSpec.from_string(xml)
        >>> apply_to_spec(spec, [AppliedEffect("viscous_damping", "j", {"damping": 3})])
        >>> float(spec.compile().dof_damping[0])
        5.0
    """
    for effect in in_order(effects):
        known = library_effect(effect.name)
        if known.on_spec is not None:
            known.on_spec(spec, effect.target, effect.values)
        if known.friction is not None:
            _enable_friction(spec, effect.target)


def compile_with(
    spec: mujoco.MjSpec, effects: Sequence[AppliedEffect]
) -> mujoco.MjModel:
    """Compile a model with effects that MJCF can express; the spec is not modified.

    Raises:
        EffectError: If MuJoCo refuses what one of them makes of the model.
    """
    changed = spec.copy()
    apply_to_spec(changed, effects)
    try:
        return changed.compile()
    except ValueError as error:
        if len(effects) > 1:
            for number in range(1, len(effects)):
                compile_with(spec, effects[:number])
        last = effects[-1]
        raise EffectError(
            last.name,
            last.target,
            f"MuJoCo does not compile the model with it ({reason(error)})",
            "give other parameters",
        ) from error


def _enable_friction(spec: mujoco.MjSpec, target: str | None) -> None:
    """Make MuJoCo create a friction constraint for friction set at each step."""
    rubbing = spec.joints if target is None else [joint_of(spec, target)]
    for joint in rubbing:
        if joint.type in ONE_AXIS:
            joint.frictionloss = max(joint.frictionloss, _LEAST_FRICTION)


def apply_to_commands(
    commands: Array, model: mujoco.MjModel, effects: Iterable[AppliedEffect]
) -> Array:
    """Return commands as the actuators receive them.

    Args:
        commands: Commands as sent, one row per physics step, (steps, actuators).
        model: The model that they drive.
        effects: The effects.
    """
    for effect in _in_path_order(effects):
        change = library_effect(effect.name).on_command
        if change is None:
            continue
        column = None if effect.target is None else actuator_of(model, effect.target)
        # Behind a gear a command is not in units of the joint, which parameters are.
        unit = 1.0 if column is None else command_at(model, column)
        if unit not in (0.0, 1.0):
            commands = commands.copy()
            commands[:, column] /= unit
        commands = change(commands, column, model.opt.timestep, effect.values)
        if unit not in (0.0, 1.0):
            commands[:, column] *= unit
    return commands


def apply_to_measurement(
    positions: Array, joints: Sequence[str], effects: Iterable[AppliedEffect]
) -> Array:
    """Return joint positions as the encoders report them.

    Args:
        positions: True positions, (..., joints), [rad or m].
        joints: Names of the columns.
        effects: The effects; those at other joints are ignored.

    Example:
        >>> scale = AppliedEffect("encoder_scale", "j", {"factor": 1.1})
        >>> shift = AppliedEffect("joint_offset", "j", {"offset": 0.5})
        >>> read = apply_to_measurement(np.array([2.0]), ["j"], [shift, scale])
        >>> read.round(6).tolist(), true_positions(read, ["j"], [scale, shift]).tolist()
        ([2.7], [2.0])
    """
    for effect in _in_path_order(effects)[::-1]:
        change = library_effect(effect.name).on_measurement
        if change is not None and effect.target in joints:
            positions = change(positions, joints.index(effect.target), effect.values)
    return positions


def true_positions(
    positions: Array, joints: Sequence[str], effects: Iterable[AppliedEffect]
) -> Array:
    """Return the true joint positions: the inverse of `apply_to_measurement`."""
    for effect in _in_path_order(effects):
        change = library_effect(effect.name).on_start
        if change is not None and effect.target in joints:
            positions = change(positions, joints.index(effect.target), effect.values)
    return positions


def step_forces(model: mujoco.MjModel, effects: Iterable[AppliedEffect]) -> StepForces:
    """Return the forces that act at each physics step of a model.

    Raises:
        RlcoError: If a user-defined law cannot be compiled.
    """
    friction: list[LawAt] = []
    torque: list[LawAt] = []
    for effect in in_order(effects):
        known = library_effect(effect.name)
        names = joints(model) if effect.target is None else (effect.target,)
        for law, found in ((known.friction, friction), (known.torque, torque)):
            if law is not None:
                found += [
                    LawAt(
                        law,
                        dof_of(model, name),
                        qpos_address(model, name),
                        effect.values,
                    )
                    for name in names
                ]
    return StepForces(table_of(friction), table_of(torque))


def controller_timing(
    model: mujoco.MjModel, effects: Iterable[AppliedEffect]
) -> ControllerTiming:
    """Return the timing of commands under a controller of tool motions."""
    timing = ControllerTiming(delay=0.0, period=0.0, lag=np.ones(model.nu))
    for effect in _in_path_order(effects):
        write = library_effect(effect.name).on_controller
        if write is not None:
            actuator = actuator_of(model, effect.target) if effect.target else -1
            write(timing, actuator, float(model.opt.timestep), effect.values)
    return timing


def _in_path_order(effects: Iterable[AppliedEffect]) -> list[AppliedEffect]:
    """Return effects in the order in which a command passes them."""
    return sorted(in_order(effects), key=lambda e: library_effect(e.name).order)


def _refusal(
    model: mujoco.MjModel, effect: AppliedEffect, allowed: tuple[str | None, ...]
) -> tuple[str, str]:
    """Return why a target is not allowed, and what to do."""
    if allowed == (None,):
        return "it acts on the whole robot", "give no target"
    if library_effect(effect.name).of_task:
        return "only rlco's own tasks read it, while they are built", "leave it out"
    servos = set(allowed) == set(servo_joints(model))
    if servos and effect.target in driven_joints(model):
        return (
            "its actuator is a motor, which is commanded by a torque and not by a goal",
            "leave it out, or give a model with position actuators",
        )
    if not allowed:
        return "the model has nothing that it acts on", "leave it out"
    names = ", ".join(str(name) for name in allowed)
    why = "the model has no such target"
    if effect.target in _named(model):
        why = "it is searched and applied at other targets alone"
    return why, f"it can act on {names}"


def _named(model: mujoco.MjModel) -> set[str]:
    """Return the names of a model's joints, bodies and geoms."""
    named = [(model.joint, model.njnt), (model.body, model.nbody)]
    named.append((model.geom, model.ngeom))
    return {one(i).name for one, count in named for i in range(count)}
