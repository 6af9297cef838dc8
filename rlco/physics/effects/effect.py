"""Declaration of an effect: its name, its parameters, and what it changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, UnknownNameError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
# A force at a joint, as a function that numba compiles: ``law(position, velocity,
# torque, carried, values)``. `position` [rad or m] and `velocity` are the joint's,
# `torque` is that of its actuators, and `carried` the magnitude of the torque between
# motor and load, ``|torque + load|`` [N m].
Law = Callable[[float, float, float, float, Sequence[float]], float]
#: What an effect may change: the model before it is compiled, commands of any kind, the
#: goals of single joints, encoder reports, forces at each step.
Site = Literal["model", "command", "goal", "reading", "step"]
#: Kinds of recordings: joint positions under commands, joint torques, a single servo on
#: a bench, the tool and the objects of a task, a body in flight.
Evidence = Literal["positions", "torques", "servo", "task", "flight"]
COMMON: tuple[Evidence, ...] = ("positions", "torques", "servo", "task")
_BEYOND = 1e6  # times what is searched
LAST = 100  # position on the path of a command, where an effect names no other


@dataclass(frozen=True)
class Present:
    """What a model has already of what a parameter changes.

    Attributes:
        value: How much: a parameter is added to it, or, where it is a ratio, times it.
        multiplied: What a ratio multiplies, such as ``mass``; ``""``: it is no ratio.
        unit: The unit of that.
    """

    value: float
    multiplied: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: Its name in reports and files.
        unit: Its unit; ``""`` for a ratio.
        low: Smallest value that is searched.
        high: Largest value that is searched.
        neutral: The value without effect.
        starts: Initial values of a search, of typical sizes. Where a small change has
            no effect (a limit that is never reached), one start is not enough.
        scales: Whether half the distance from `neutral` has about half the effect.
            Limits and periods do not scale: they have no effect until reached.
        resolution: Change at which the effect is discontinuous; values a few of these
            away are tried besides gradient steps. 0 where it is smooth.
        present: What the model has of it already, for reports to say before and after;
            None where that is nothing, or not one number.
        step: Change at which a derivative is taken; 0: a share of the value and of the
            starts, which for the number of waves along a path would be far too much.
        most: Largest magnitude that may be given, beyond what is searched; None: a
            million times that.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    starts: tuple[float, ...]
    scales: bool = True
    resolution: float = 0.0
    present: Present | None = None
    step: float = 0.0
    most: float | None = None

    @property
    def largest(self) -> float:
        """The largest magnitude that may be given: what is beyond only overflows.

        Example:
            >>> Parameter("offset", "rad", -0.3, 0.3, 0.0, (0.01,)).largest
            300000.0
        """
        if self.most is not None:
            return self.most
        return _BEYOND * max(abs(self.low), abs(self.high), abs(self.neutral))

    def after(self, value: float) -> float:
        """Return what the model has with a value of it; that, where nothing is present.

        Example:
            >>> Parameter("damping", "N m s/rad", 0, 99, 0, (), present=Present(12.0)
            ...     ).after(24.0)
            36.0
            >>> Parameter("factor", "", 0, 9, 1, (), present=Present(0.4, "mass", "kg")
            ...     ).after(1.5)  # doctest: +ELLIPSIS
            0.6...
        """
        if self.present is None:
            return value
        if self.present.multiplied:
            return self.present.value * value
        # What a value replaces, such as a limit, is neutral at what the model has.
        return self.present.value + value - self.neutral


@dataclass
class ControllerTiming:
    """Timing of commands under a controller of tool motions; nu actuators.

    Attributes:
        delay: Seconds between a command and its execution.
        period: Seconds between two reads of commands; 0: immediately.
        lag: Fraction of the distance to its command that an actuator moves in a step,
            (nu,).
        random_mean: Mean of what each command is late besides, by a time of its own
            with a gamma distribution [s].
        random_variance: Its variance [s^2]; 0: none is late besides.
    """

    delay: float
    period: float
    lag: Array
    random_mean: float = 0.0
    random_variance: float = 0.0


@dataclass(frozen=True)
class Effect:
    """A physical effect that a simulator may lack, or have with another size.

    It is declared here once, and acts wherever a robot is simulated. `values` are
    always in the order of `parameters`. Attributes that do not apply are omitted.

    Attributes:
        name: A name of the library, or a user's own.
        summary: Description in one sentence.
        signature: Its trace in measured minus simulated positions.
        confused_with: Effects that slow or poor recordings cannot distinguish from it.
        targets: ``targets(model)`` returns the possible targets: names of joints (also
            for their actuators), bodies or geoms, or ``(None,)`` if it acts on the
            whole robot.
        parameters: ``parameters(model, target)``.
        on_spec: ``on_spec(spec, target, values)`` changes an `MjSpec` before it is
            compiled.
        on_command: ``on_command(commands, column, timestep, values)`` returns the
            commands [steps, actuators] as the actuators receive them; `column` is the
            target's actuator, or None for all.
        on_controller: ``on_controller(timing, actuator, timestep, values)`` enters the
            equivalent of `on_command` into `ControllerTiming`, for commands that are
            tool motions. Without it, the effect needs joints that are commanded by
            position.
        on_measurement: ``on_measurement(positions, column, values)`` returns the
            positions [..., joints] as the encoder reports them.
        on_start: ``on_start(positions, column, values)``: its inverse, for initial
            positions.
        friction: A `Law` of the friction that it adds to a joint, 0 or more [N m].
        torque: A `Law` of the torque that it adds to a joint [N m].
        of_task: Whether rlco's tasks read it while they are built, instead of all of
            the above; see `rlco.physics.effects.scene`.
        order: Its position on the path of a command, from the sender on. A measurement
            inverts the encoder's part of that path.
        shown_by: The kinds of recordings that can reveal it.
        at_fixtures: Whether the joint of a drawer or a door may have it.
        held: Whether it is a body in the hand.
        tolerances: Kinds of the model's own parameters (``damping``, ``mass``; see
            `rlco.gap.compare.model_tolerance`) that it changes at its target.
        by_hand: What to record where no motion of the arm would reveal it, a sentence.
        candidate: Whether a search tries it; otherwise it acts only where it is given.
        uncommon: Whether a search tries it only where all others leave something; see
            `rlco.gap.search.steps.uncommon`.
        refuse: ``refuse(values)`` returns why it cannot have these values and what to
            do, two parts of a sentence, or None where it can.
    """

    name: str
    summary: str
    signature: str
    confused_with: tuple[str, ...]
    targets: Callable[[mujoco.MjModel], tuple[str | None, ...]]
    parameters: Callable[[mujoco.MjModel, str | None], tuple[Parameter, ...]]
    on_spec: Callable[[mujoco.MjSpec, str | None, Array], None] | None = None
    on_command: Callable[[Array, int | None, float, Array], Array] | None = None
    on_controller: Callable[[ControllerTiming, int, float, Array], None] | None = None
    on_measurement: Callable[[Array, int, Array], Array] | None = None
    on_start: Callable[[Array, int, Array], Array] | None = None
    friction: Law | None = None
    torque: Law | None = None
    of_task: bool = False
    order: int = LAST
    shown_by: tuple[Evidence, ...] = COMMON
    at_fixtures: bool = False
    held: bool = False
    tolerances: tuple[str, ...] = ()
    by_hand: str | None = None
    candidate: bool = True
    uncommon: bool = False
    refuse: Callable[[Array], tuple[str, str] | None] | None = None

    @property
    def acts_on(self) -> frozenset[Site]:
        """What it changes, inferred from its functions."""
        encoder = self.on_measurement is not None
        command = self.on_command is not None and not encoder
        sites: dict[Site, bool] = {
            "model": self.on_spec is not None,
            "command": command and self.on_controller is not None,
            "goal": command and self.on_controller is None,
            "reading": encoder,
            "step": self.friction is not None or self.torque is not None,
        }
        return frozenset(site for site, found in sites.items() if found)


@dataclass(frozen=True)
class AppliedEffect:
    """An effect with a target and parameter values: data, as in ``effects.yaml``.

    Example:
        >>> AppliedEffect("viscous_damping", "joint4", {"damping": 8.0}).values
        array([8.])
    """

    name: str
    target: str | None
    parameters: Mapping[str, float]

    @property
    def values(self) -> Array:
        """The parameter values in their order, (parameters,)."""
        return np.array(list(self.parameters.values()), dtype=float)


#: Units at a hinge, and what they are at a slide.
_AT_SLIDES = {
    "rad": "m",
    "rad/s": "m/s",
    "N m": "N",
    "N m s/rad": "N s/m",
    "N m/rad": "N/m",
    "N m/rad^3": "N/m^3",
    "rad/(N m)": "m/N",
    "1/(N m)": "1/N",
    "kg m^2": "kg",
}


def with_units_of_slides(effect: Effect) -> Effect:
    """Return an effect whose parameters at a slide have the units of one.

    Effects are declared with the units of a hinge, such as N m, which is N at a slide.

    Args:
        effect: As declared.
    """
    declared = effect.parameters

    def parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
        found = declared(model, target)
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, target or "")
        if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_SLIDE:
            return found
        return tuple(_at_slide(parameter) for parameter in found)

    return replace(effect, parameters=parameters)


def _at_slide(parameter: Parameter) -> Parameter:
    present = parameter.present
    if present is not None:
        present = replace(present, unit=_AT_SLIDES.get(present.unit, present.unit))
    unit = _AT_SLIDES.get(parameter.unit, parameter.unit)
    return replace(parameter, unit=unit, present=present)


def require(found: bool, kind: str, target: str | None, known: list[str]) -> None:
    """Check that a target exists.

    Raises:
        UnknownNameError: If it does not.
    """
    if not found:
        raise UnknownNameError(kind, str(target), known)


def joint_of(spec: mujoco.MjSpec, target: str | None) -> mujoco.MjsJoint:
    """Return a joint of a spec by its name.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    # `spec.joint` is wrong in a copy of a compiled spec with added elements.
    joints = {joint.name: joint for joint in spec.joints}
    require(target in joints, "joint", target, [*joints])
    return joints[target]


def actuators_of(spec: mujoco.MjSpec, target: str | None) -> list[mujoco.MjsActuator]:
    """Return the actuators that drive a joint.

    Raises:
        RlcoError: If none does.
    """
    joint_of(spec, target)
    found = [a for a in spec.actuators if a.target == target]
    if not found:
        message = f"no actuator drives joint {target!r}: "
        raise RlcoError(message + "give a joint that an actuator drives.")
    return found


def body_of(spec: mujoco.MjSpec, target: str | None) -> mujoco.MjsBody:
    """Return a body of a spec by its name.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    bodies = {body.name: body for body in spec.bodies}  # as for joints
    require(target in bodies, "body", target, [*bodies])
    return bodies[target]
