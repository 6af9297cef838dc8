"""A robot's model with effects applied, of which its controller knows nothing.

A robot's controller uses its maker's model. Where an effect changes masses, gravity or
encoder reports, the simulated controller continues to compute kinematics, inertia and
gravity with the model without the effect, at the reported joint positions. The effect
acts on the joints alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError, RlcoError
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import (
    EffectError,
    apply_to_measurement,
    check_of_task,
    checked,
    compile_with,
    controller_timing,
    in_order,
    library_effect,
    step_forces,
)
from rlco.physics.effects.command import delay_quantiles
from rlco.physics.effects.effect import ControllerTiming
from rlco.physics.effects.effects_file import EffectsFile, read_effects
from rlco.physics.effects.names import in_model
from rlco.physics.effects.step_forces import StepForces, no_forces
from rlco.physics.effects.targets import ONE_AXIS

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Given = str | Path | Sequence[AppliedEffect] | EffectsFile | None
# Joint commands, which a controller of tool motions does not use.
_NO_GOAL = "the task's actions move the tool, and its joints have no goals of their own"
# Model fields that such a controller uses: changing them for a robot matters.
_BODY_FIELDS = ("body_mass", "body_ipos", "body_iquat", "body_inertia")


class Acting(NamedTuple):
    """The action of effects in each physics step, as compiled loops read it.

    With nv degrees of freedom and nu actuators.
    """

    whole: int  # delay of a command in control steps
    phase: int  # and additional physics steps
    random: Integers  # equally likely delays besides [physics steps], (Q,); (0,): none
    room: int  # commands that may be on their way at once
    period: float  # physics steps between two reads of commands; 0: immediately
    controller_model: int  # address of the controller's own model; 0: the same
    reported: Array  # encoder reports: factors and offsets, (2, nq)
    reported_speed: Array  # factors of velocities, (nv,)
    lags: bool
    lag: Array  # fraction of the distance to its command that an actuator moves, (nu,)
    forces: StepForces


@dataclass(frozen=True)
class CorrectedModel:
    """A compiled model with effects, and their action beyond the model.

    Attributes:
        model: With the effects that MJCF can express.
        controller_model: The controller's own model, where it is not `model`.
        effects: All effects; their targets are names in the model.
        forces: Forces at each physics step.
        reported: Encoder reports: factors and offsets of joint positions, (2, nq).
        lag: Fraction of the distance to its command that an actuator moves in a step,
            (nu,).
        delay: Physics steps between a command and its execution.
        period: Physics steps between two reads of commands; 0: immediately.
        random_delay: Equally likely delays of which each command has one besides
            [physics steps], (Q,); (0,): none.
    """

    model: mujoco.MjModel
    controller_model: mujoco.MjModel | None
    effects: tuple[AppliedEffect, ...]
    forces: StepForces
    reported: Array
    lag: Array
    delay: int
    period: float
    random_delay: Integers

    def reported_speed(self) -> Array:
        """Return the factors of velocities in encoder reports, (nv,)."""
        model = self.model
        factors = np.ones(model.nv)
        for joint in range(model.njnt):
            if model.jnt_type[joint] in ONE_AXIS:
                factor = self.reported[0, model.jnt_qposadr[joint]]
                factors[model.jnt_dofadr[joint]] = factor
        return factors

    def acting(self, substeps: int) -> Acting:
        """Return values for compiled loops, given physics steps per control step."""
        whole, phase = divmod(self.delay, substeps)
        room = whole
        if self.random_delay.size:
            longest = self.delay + int(self.random_delay.max()) + ceil(self.period)
            room = longest // substeps + 1
        return Acting(
            whole=whole,
            phase=phase,
            random=self.random_delay,
            room=room,
            period=self.period,
            controller_model=0
            if self.controller_model is None
            else self.controller_model._address,
            reported=self.reported,
            reported_speed=self.reported_speed(),
            lags=bool((self.lag < 1.0).any()),
            lag=self.lag,
            forces=self.forces,
        )


def without_effects(model: mujoco.MjModel) -> CorrectedModel:
    """Return a model without effects."""
    return CorrectedModel(
        model=model,
        controller_model=None,
        effects=(),
        forces=no_forces(),
        reported=_truth(model),
        lag=np.ones(model.nu),
        delay=0,
        period=0.0,
        random_delay=np.zeros(0, dtype=np.int64),
    )


def given_effects(effects: Given) -> EffectsFile | None:
    """Return effects given in any of the allowed forms, or None if there are none.

    Raises:
        DataError: If the file cannot be read.
        UnknownNameError: If an effect is not in the library.
        RlcoError: If it is neither a path nor a list of effects.
        EffectError: If an effect needs a joint that is commanded by position.
    """
    if effects is None:
        return None
    if isinstance(effects, str | Path):
        path, effects = effects, read_effects(effects)
        if effects.sensors is not None:
            raise DataError(
                f"effects file {str(path)!r} has sensors, but effects= adds only "
                "effects; give it as domain=."
            )
    if not isinstance(effects, EffectsFile):
        if isinstance(effects, Mapping) or not isinstance(effects, Iterable):
            raise _no_effects(effects)
        effects = EffectsFile(tuple(effects))
    for effect in effects.effects:
        if not isinstance(effect, AppliedEffect):
            raise _no_effects(effect)
        known = library_effect(effect.name)
        if "goal" in known.acts_on:
            raise EffectError(effect.name, effect.target, _NO_GOAL, "leave it out")
        if known.of_task:
            check_of_task(effect)
    return effects if effects.effects else None


@dataclass(frozen=True)
class PlainModel:
    """A model without effects, from which those with effects are compiled.

    Attributes:
        spec: The model; never modified.
        model: The same, compiled: the controller's own.
    """

    spec: mujoco.MjSpec
    model: mujoco.MjModel

    @classmethod
    def of(cls, xml: str) -> PlainModel:
        """Return the model of an MJCF."""
        spec = mujoco.MjSpec.from_string(xml)
        return cls(spec, spec.compile())

    def checked(self, given: EffectsFile) -> list[AppliedEffect]:
        """Return effects with targets that are names in the model.

        Raises:
            UnknownNameError: If a target is not in the model.
            EffectError: If an effect cannot be applied there.
        """
        found = in_model(given.effects, self.model, given.names)
        return [checked(self.model, effect, controlled=True) for effect in found]

    def with_effects(self, effects: Sequence[AppliedEffect]) -> CorrectedModel:
        """Return the model with effects that were checked; see `correct`."""
        return correct(self.spec, self.model, effects)


def correct(
    spec: mujoco.MjSpec, plain: mujoco.MjModel, effects: Sequence[AppliedEffect]
) -> CorrectedModel:
    """Compile a model with effects that were checked.

    Args:
        spec: The model without them; not modified.
        plain: The same, compiled: the controller's own model.
        effects: The effects.

    Raises:
        EffectError: If one adds joints or actuators, or makes a model that MuJoCo
            refuses.
    """
    model = compile_with(spec, effects)
    if (model.nq, model.nv, model.nu) != (plain.nq, plain.nv, plain.nu):
        extra = next(e for e in effects if library_effect(e.name).on_spec is not None)
        raise EffectError(
            extra.name,
            extra.target,
            "it adds joints or actuators, which the robot's controller does not know",
            "leave it out",
        )
    reported = _reported(plain, effects)
    wrong = not np.array_equal(reported, _truth(plain)) or _computed_differs(
        plain, model
    )
    step, timing = float(plain.opt.timestep), controller_timing(plain, effects)
    return CorrectedModel(
        model=model,
        controller_model=plain if wrong else None,
        effects=tuple(in_order(effects)),
        forces=step_forces(model, effects),
        reported=reported,
        lag=timing.lag,
        delay=round(timing.delay / step),
        period=_period(timing.period / step),
        random_delay=_random_delay(timing, step),
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


def _random_delay(timing: ControllerTiming, step: float) -> Integers:
    if timing.random_variance == 0.0:
        return np.zeros(0, dtype=np.int64)
    return delay_quantiles(timing.random_mean, timing.random_variance, step)


def _period(steps: float) -> float:
    return steps if steps > 1.0 else 0.0


def _truth(model: mujoco.MjModel) -> Array:
    return np.stack([np.ones(model.nq), np.zeros(model.nq)])


def _reported(model: mujoco.MjModel, effects: Sequence[AppliedEffect]) -> Array:
    """Return factors and offsets of encoder reports, (2, nq).

    Raises:
        EffectError: If a user-defined effect is not of that form.
    """
    reported = _truth(model)
    joints = [e.target for e in effects if library_effect(e.name).on_measurement]
    for joint in joints:
        at = int(model.joint(joint).qposadr[0])
        zero, one, two = (
            float(apply_to_measurement(np.array([x]), [str(joint)], effects)[0])
            for x in (0.0, 1.0, 2.0)
        )
        if abs(two - 2.0 * one + zero) > 1e-9:
            name = next(e.name for e in effects if e.target == joint)
            reason = "its measurement is not a factor and offset of the position"
            raise EffectError(name, joint, reason, "leave it out")
        reported[:, at] = (one - zero, zero)
    return reported


def _computed_differs(plain: mujoco.MjModel, corrected: mujoco.MjModel) -> bool:
    """Return whether the robot's inertia or gravity differs between two models."""
    if plain.nbody != corrected.nbody:
        return True
        # A controller does not model free bodies.
    driven = {plain.dof_bodyid[d] for d in actuated_dofs(plain) if d >= 0}
    roots = {plain.body_rootid[body] for body in driven}
    robot = np.isin(plain.body_rootid, list(roots))
    same = [
        np.array_equal(getattr(plain, name)[robot], getattr(corrected, name)[robot])
        for name in _BODY_FIELDS
    ]
    same.append(np.array_equal(plain.dof_armature, corrected.dof_armature))
    same.append(np.array_equal(plain.opt.gravity, corrected.opt.gravity))
    return not all(same)
