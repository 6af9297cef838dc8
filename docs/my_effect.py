"""An effect of one's own: drag that grows with the square of a joint's speed."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects import Effect, Parameter, register
from rlco.physics.effects.targets import holding_torque, joints


def parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    """One number: what it is, its unit, its bounds, and where a search starts."""
    torque = holding_torque(model, str(target))  # what this joint carries, at 1 rad/s
    starts = (0.05 * torque, 0.3 * torque)
    return (Parameter("drag", "N m s2/rad2", 0.0, 10.0 * torque, 0.0, starts),)


def on_spec(spec: mujoco.MjSpec, target: str | None, values: np.ndarray) -> None:
    """Change the model before it is compiled: MuJoCo's damping is a polynomial."""
    damping = np.array(spec.joint(target).damping, dtype=float)
    damping[1] += values[0]
    spec.joint(target).damping = damping


register(
    Effect(
        name="quadratic_drag",
        summary="A torque against a joint's motion, with the square of its speed.",
        signature="A residual that shows in the fastest motion alone.",
        confused_with=("viscous_damping", "velocity_limit"),
        targets=joints,
        parameters=parameters,
        on_spec=on_spec,
    )
)
