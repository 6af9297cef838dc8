"""What an effect is: a name, its parameters, and how it changes a simulated robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, UnknownNameError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: What it is called in reports and files.
        unit: Its unit; ``""`` for a ratio.
        low: Smallest value that is searched.
        high: Largest value that is searched.
        neutral: The value at which the effect does nothing.
        starts: Values that a search starts from, of typical sizes: where a small
            change shows nothing (a limit that is never reached), one start misses it.
        scales: Whether half the way from `neutral` has about half the effect. Limits
            and periods do not scale: nothing happens until something reaches them.
        resolution: A change at which the effect jumps instead of growing; values a few
            of them away are tried beside gradient steps. 0 where it grows smoothly.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    starts: tuple[float, ...]
    scales: bool = True
    resolution: float = 0.0


@dataclass
class StepTerms:
    """What acts at each physics step and MJCF cannot say; zero means absent.

    Attributes:
        static: Friction beyond Coulomb's at rest, a degree of freedom, (nv,) [N m].
        stribeck_speed: Speed at which it has fallen to 1/e, (nv,) [rad/s].
        load: Friction for each unit of transmitted torque, (nv,).
        drive: Torque lost at the actuator, as a part of its torque for each unit of
            torque, (nu,) [1/(N m)].
    """

    static: Array
    stribeck_speed: Array
    load: Array
    drive: Array

    @classmethod
    def none(cls, model: mujoco.MjModel) -> StepTerms:
        """Return the terms of a model that has none of these effects."""
        dofs, actuators = np.zeros((3, model.nv)), np.zeros(model.nu)
        return cls(dofs[0], dofs[1] + 1.0, dofs[2], actuators)

    @property
    def act(self) -> bool:
        """Whether any of them is not zero."""
        return bool(self.static.any() or self.load.any() or self.drive.any())


@dataclass(frozen=True)
class Effect:
    """A physical effect that a simulator may lack, or have with another size.

    An effect changes one or more of: the model before it is compiled (`on_spec`), the
    commands on their way to the actuators (`on_command`), what the encoder says
    (`on_measurement`, with `on_start` as its inverse for initial positions), and what
    acts at each physics step (`on_step`). `values` are in the order of `parameters`.

    Attributes:
        name: One of the fixed names, or a user's own.
        summary: What it is, in one sentence.
        signature: What it leaves in measured minus simulated positions.
        confused_with: Effects that slow or poor recordings cannot tell it from.
        targets: ``targets(model)``: what it may act on: names of joints (their
            actuators bear the joint's name), bodies or geoms, or ``(None,)`` where it
            acts on the whole robot.
        parameters: ``parameters(model, target)``.
        on_spec: ``on_spec(spec, target, values)`` changes an `MjSpec`.
        on_command: ``on_command(commands, column, timestep, values)`` returns the
            commands [steps, actuators] as the actuators get them; `column` is the
            target's actuator, or None for all.
        on_measurement: ``on_measurement(positions, column, values)`` returns the
            positions [..., joints] as the encoder tells them.
        on_start: ``on_start(positions, column, values)``: true from told positions.
        on_step: ``on_step(terms, dof, actuator, values)`` writes into `StepTerms`.
    """

    name: str
    summary: str
    signature: str
    confused_with: tuple[str, ...]
    targets: Callable[[mujoco.MjModel], tuple[str | None, ...]]
    parameters: Callable[[mujoco.MjModel, str | None], tuple[Parameter, ...]]
    on_spec: Callable[[mujoco.MjSpec, str | None, Array], None] | None = None
    on_command: Callable[[Array, int | None, float, Array], Array] | None = None
    on_measurement: Callable[[Array, int, Array], Array] | None = None
    on_start: Callable[[Array, int, Array], Array] | None = None
    on_step: Callable[[StepTerms, int, int, Array], None] | None = None


@dataclass(frozen=True)
class AppliedEffect:
    """An effect with a target and numbers: data, as in ``effects.yaml``.

    Example:
        >>> AppliedEffect("viscous_damping", "joint4", {"damping": 8.0}).values
        array([8.])
    """

    name: str
    target: str | None
    parameters: Mapping[str, float]

    @property
    def values(self) -> Array:
        """The numbers in their order, (parameters,)."""
        return np.array(list(self.parameters.values()), dtype=float)


def require(found: bool, kind: str, target: str | None, known: list[str]) -> None:
    """Raise unless a target exists.

    Raises:
        UnknownNameError: Where it does not.
    """
    if not found:
        raise UnknownNameError(kind, str(target), known)


def joint_of(spec: mujoco.MjSpec, target: str | None) -> mujoco.MjsJoint:
    """Return a joint of a spec by its name.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    joint = spec.joint(target) if target else None
    require(joint is not None, "joint", target, [j.name for j in spec.joints])
    return joint


def actuators_of(spec: mujoco.MjSpec, target: str | None) -> list[mujoco.MjsActuator]:
    """Return the actuators that drive a joint.

    Raises:
        RlcoError: If none does.
    """
    joint_of(spec, target)
    found = [a for a in spec.actuators if a.target == target]
    if not found:
        message = f"no actuator drives joint {target!r}: "
        raise RlcoError(message + "give a joint that one drives.")
    return found


def body_of(spec: mujoco.MjSpec, target: str | None) -> mujoco.MjsBody:
    """Return a body of a spec by its name.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    body = spec.body(target) if target else None
    require(body is not None, "body", target, [b.name for b in spec.bodies])
    return body
