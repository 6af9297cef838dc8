"""A robot's model with effects in it, and what its controller knows of them: nothing.

A robot's controller computes with the model of its makers. So where an effect changes
masses, gravity or what encoders tell, the simulated controller goes on computing
kinematics, inertia and gravity of the model without the effect, at the joint positions
that it is told, and the effect acts on the joints alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.physics.effects import AppliedEffect, StepTerms
from rlco.physics.effects.actuator_lag import lag_part
from rlco.physics.effects.apply import (
    EffectError,
    apply_to_measurement,
    apply_to_spec,
    checked,
    in_order,
    library_effect,
    step_terms,
)
from rlco.physics.effects.effects_file import EffectsFile, read_effects
from rlco.physics.effects.names import in_model
from rlco.physics.effects.targets import ONE_AXIS, actuator_of

Array = NDArray[np.float64]
Given = str | Path | Sequence[AppliedEffect] | EffectsFile | None
# Commands of a joint that a controller of tool moves has no use for, and why.
_NO_GOAL = "the task's actions move the tool, and its joints have no goals of their own"
_ON_THE_WAY = ("command_delay", "control_rate", "actuator_lag")
# What a controller computes with; another number of a robot's makes a difference to it.
_BODY_FIELDS = ("body_mass", "body_ipos", "body_iquat", "body_inertia")


class Acting(NamedTuple):
    """What effects amount to in each physics step; the compiled loops read it as it is.

    With nv degrees of freedom and nu actuators.
    """

    whole: int  # control steps that a command travels
    phase: int  # and physics steps beyond them
    period: float  # physics steps between two readings of commands; 0: as they come
    believed: int  # address of the model that the controller computes with; 0: the same
    told: Array  # what encoders tell: factors and offsets, (2, nq)
    told_speed: Array  # factors of velocities, (nv,)
    lags: bool
    lag: Array  # part of the way to its command that an actuator goes, (nu,)
    terms: bool
    static: Array  # see `StepTerms`, (nv,)
    speed: Array  # (nv,)
    load: Array  # (nv,)
    drive: Array  # (nu,)
    dofs: NDArray[np.int64]  # the degree of freedom of each actuator, -1: none, (nu,)


@dataclass(frozen=True)
class MendedModel:
    """A compiled model with effects, and what acts beside it.

    Attributes:
        model: With the effects that MJCF can hold.
        believed: What the controller computes with, where that is not `model`.
        effects: All effects, their targets being names in the model.
        terms: What acts at each physics step.
        told: What encoders tell: factors and offsets of joint positions, (2, nq).
        lag: Part of the way to its command that an actuator goes in a step, (nu,).
        delay: Physics steps between a command and its execution.
        period: Physics steps between two readings of commands; 0: as they come.
    """

    model: mujoco.MjModel
    believed: mujoco.MjModel | None
    effects: tuple[AppliedEffect, ...]
    terms: StepTerms
    told: Array
    lag: Array
    delay: int
    period: float

    def told_speed(self) -> Array:
        """Return what encoders tell of velocities: factors, (nv,)."""
        model = self.model
        factors = np.ones(model.nv)
        for joint in range(model.njnt):
            if model.jnt_type[joint] in ONE_AXIS:
                factor = self.told[0, model.jnt_qposadr[joint]]
                factors[model.jnt_dofadr[joint]] = factor
        return factors

    def acting(self, substeps: int) -> Acting:
        """Return it as numbers, with so many physics steps in a control step."""
        whole, phase = divmod(self.delay, substeps)
        return Acting(
            whole=whole,
            phase=phase,
            period=self.period,
            believed=0 if self.believed is None else self.believed._address,
            told=self.told,
            told_speed=self.told_speed(),
            lags=bool((self.lag < 1.0).any()),
            lag=self.lag,
            terms=self.terms.act,
            static=self.terms.static,
            speed=self.terms.stribeck_speed,
            load=self.terms.load,
            drive=self.terms.drive,
            dofs=actuated_dofs(self.model),
        )


def without_effects(model: mujoco.MjModel) -> MendedModel:
    """Return a model as it is."""
    return MendedModel(
        model=model,
        believed=None,
        effects=(),
        terms=StepTerms.none(model),
        told=_truth(model),
        lag=np.ones(model.nu),
        delay=0,
        period=0.0,
    )


def given_effects(effects: Given) -> EffectsFile | None:
    """Return effects as they may be given, or None where there are none.

    Raises:
        DataError: If the file cannot be read.
        UnknownNameError: If an effect is not in the library.
        RlcoError: If it is neither a path nor a list of effects.
        EffectError: If an effect needs a joint that is commanded by its position.
    """
    if effects is None:
        return None
    if isinstance(effects, str | Path):
        effects = read_effects(effects)
    if not isinstance(effects, EffectsFile):
        if isinstance(effects, Mapping) or not isinstance(effects, Iterable):
            raise _no_effects(effects)
        effects = EffectsFile(tuple(effects))
    for effect in effects.effects:
        if not isinstance(effect, AppliedEffect):
            raise _no_effects(effect)
        known = library_effect(effect.name)
        moves_joints = known.on_command is not None and known.on_measurement is None
        if moves_joints and effect.name not in _ON_THE_WAY:
            raise EffectError(effect.name, effect.target, _NO_GOAL, "leave it out")
    return effects if effects.effects else None


def compile_mended(xml: str, given: EffectsFile) -> MendedModel:
    """Compile a model with effects in it.

    Args:
        xml: MJCF of the model without them.
        given: The effects.

    Raises:
        UnknownNameError: If a target is not in the model.
        EffectError: If an effect cannot be applied there.
    """
    spec = mujoco.MjSpec.from_string(xml)
    plain = spec.compile()
    effects = [
        checked(plain, effect, controlled=True)
        for effect in in_model(given.effects, plain, given.names)
    ]
    return mend(spec, plain, effects)


def mend(
    spec: mujoco.MjSpec, plain: mujoco.MjModel, effects: Sequence[AppliedEffect]
) -> MendedModel:
    """Compile a model with effects that were checked.

    Args:
        spec: The model without them; stays as it is.
        plain: The same, compiled: what the robot's controller believes.
        effects: The effects.

    Raises:
        EffectError: If one adds joints or actuators.
    """
    mended = spec.copy()
    apply_to_spec(mended, effects)
    model = mended.compile()
    if (model.nq, model.nv, model.nu) != (plain.nq, plain.nv, plain.nu):
        extra = next(e for e in effects if library_effect(e.name).on_spec is not None)
        raise EffectError(
            extra.name,
            extra.target,
            "it adds joints or actuators, which the robot's controller does not know",
            "leave it out",
        )
    told = _told(plain, effects)
    wrong = not np.array_equal(told, _truth(plain)) or _computed_differs(plain, model)
    step = float(plain.opt.timestep)
    return MendedModel(
        model=model,
        believed=plain if wrong else None,
        effects=tuple(in_order(effects)),
        terms=step_terms(model, effects),
        told=told,
        lag=_lag(plain, effects),
        delay=round(_number(effects, "command_delay") / step),
        period=_period(_number(effects, "control_rate") / step),
    )


def actuated_dofs(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the degree of freedom that each actuator drives, -1 for none, (nu,)."""
    dofs = np.full(model.nu, -1, dtype=np.int64)
    joints = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    dofs[joints] = model.jnt_dofadr[model.actuator_trnid[joints, 0]]
    return dofs


def _no_effects(given: object) -> RlcoError:
    return RlcoError(
        f"effects={given!r} is not allowed; give the path of an effects.yaml, or a "
        "list of AppliedEffect."
    )


def _number(effects: Iterable[AppliedEffect], name: str) -> float:
    return float(sum(e.values[0] for e in effects if e.name == name))


def _period(steps: float) -> float:
    return steps if steps > 1.0 else 0.0


def _lag(model: mujoco.MjModel, effects: Iterable[AppliedEffect]) -> Array:
    """Return the part of the way that each actuator goes in a step, (actuators,)."""
    lag = np.ones(model.nu)
    step = float(model.opt.timestep)
    for effect in effects:
        if effect.name == "actuator_lag":
            actuator = actuator_of(model, str(effect.target))
            lag[actuator] = lag_part(float(effect.values[0]), step)
    return lag


def _truth(model: mujoco.MjModel) -> Array:
    return np.stack([np.ones(model.nq), np.zeros(model.nq)])


def _told(model: mujoco.MjModel, effects: Sequence[AppliedEffect]) -> Array:
    """Return factors and offsets of what encoders tell, (2, nq).

    Raises:
        EffectError: If an effect of a user's own is not of that form.
    """
    told = _truth(model)
    joints = [e.target for e in effects if library_effect(e.name).on_measurement]
    for joint in joints:
        at = int(model.joint(joint).qposadr[0])
        zero, one, two = (
            float(apply_to_measurement(np.array([x]), [str(joint)], effects)[0])
            for x in (0.0, 1.0, 2.0)
        )
        if abs(two - 2.0 * one + zero) > 1e-9:
            name = next(e.name for e in effects if e.target == joint)
            reason = "its measurement is no factor and offset of the position"
            raise EffectError(name, joint, reason, "leave it out")
        told[:, at] = (one - zero, zero)
    return told


def _computed_differs(plain: mujoco.MjModel, mended: mujoco.MjModel) -> bool:
    """Return whether a robot's inertia or gravity is another one than before."""
    if plain.nbody != mended.nbody:
        return True
    # A controller computes nothing of bodies that fly or lie about.
    driven = {plain.dof_bodyid[d] for d in actuated_dofs(plain) if d >= 0}
    roots = {plain.body_rootid[body] for body in driven}
    robot = np.isin(plain.body_rootid, list(roots))
    same = [
        np.array_equal(getattr(plain, name)[robot], getattr(mended, name)[robot])
        for name in _BODY_FIELDS
    ]
    same.append(np.array_equal(plain.dof_armature, mended.dof_armature))
    same.append(np.array_equal(plain.opt.gravity, mended.opt.gravity))
    return not all(same)
