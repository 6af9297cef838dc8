"""A spring at a joint: a cable or a counterbalance."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.effect import Array, Effect, Parameter, joint_of
from rlco.physics.effects.targets import holding_torque, joints


def _parameters(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    scale = holding_torque(model, str(target))
    stiffness = Parameter(
        "stiffness", "N m/rad", 0.0, 50.0 * scale, 0.0, (0.1 * scale, 0.5 * scale)
    )
    return (stiffness, Parameter("rest", "rad", -3.0, 3.0, 0.0, (0.0,)))


def _on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    joint = joint_of(spec, target)
    stiffness = np.array(joint.stiffness, dtype=float)
    present = stiffness[0]
    total = max(present + values[0], 1e-12)
    # A file in degrees tells the rest of a hinge in them.
    hinge = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    rest = np.degrees(values[1]) if hinge and spec.compiler.degree else values[1]
    # Two springs are one, with the mean of their rests weighted by their stiffness.
    joint.springref = (present * joint.springref + values[0] * rest) / total
    joint.stiffness = stiffness + np.eye(len(stiffness))[0] * values[0]


EFFECT = Effect(
    name="joint_stiffness",
    summary="A spring pulls a joint to a rest angle.",
    signature="A torque linear in the joint's angle, not in its sine.",
    confused_with=("torque_bias", "payload", "actuator_gain"),
    targets=joints,
    parameters=_parameters,
    on_spec=_on_spec,
)
