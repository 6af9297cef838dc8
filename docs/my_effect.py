"""An effect of one's own: drag that grows with the square of a joint's speed."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from rlco.physics.effects import Effect, Parameter, register
from rlco.physics.effects.targets import holding_torque, joints


def parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    """One number: what it is, its unit, its bounds, and where a search starts."""
    torque = holding_torque(model, str(target))  # what this joint carries, at 1 rad/s
    starts = (0.05 * torque, 0.3 * torque)
    return (Parameter("drag", "N m s2/rad2", 0.0, 10.0 * torque, 0.0, starts),)


def drag(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    """Return the torque that it adds to the joint at each physics step [N m]."""
    return -values[0] * abs(velocity) * velocity


register(
    Effect(
        name="quadratic_drag",
        summary="A torque against a joint's motion, with the square of its speed.",
        signature="A residual that shows in the fastest motion alone.",
        confused_with=("viscous_damping", "velocity_limit"),
        targets=joints,
        parameters=parameters,
        torque=drag,
    )
)
