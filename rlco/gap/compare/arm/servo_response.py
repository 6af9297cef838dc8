"""What torques at a joint do to its position while its servo holds it, to first order.

A rollout for each of hundreds of torques would take minutes. For small torques a joint
under its servo is a mass on a spring with a damper, and hundreds take milliseconds:
close enough to choose those that are worth a rollout.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import actuator_of, dof_of, is_servo


@dataclass(frozen=True)
class JointResponse:
    """A joint under its servo: ``inertia q'' + damping q' + stiffness q = torque``.

    Attributes:
        inertia: [kg m^2]
        damping: [N m s/rad]
        stiffness: [N m/rad]
    """

    inertia: float
    damping: float
    stiffness: float

    @classmethod
    def of(cls, model: mujoco.MjModel, joint: str, qpos: Array) -> JointResponse | None:
        """Return the response of a joint, the others held; None without a servo.

        Args:
            model: The robot.
            joint: Its joint.
            qpos: A usual pose, (nq,).
        """
        actuator, dof = actuator_of(model, joint), dof_of(model, joint)
        if actuator < 0 or not is_servo(model, actuator):
            return None
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        gear = float(model.actuator_gear[actuator, 0])
        _, stiffness, damping = -gear * gear * model.actuator_biasprm[actuator, :3]
        return cls(
            inertia=float(data.qM[model.dof_Madr[dof]]),
            damping=float(damping + model.dof_damping[dof]),
            stiffness=float(stiffness + model.jnt_stiffness[model.dof_jntid[dof]]),
        )

    def positions(self, torques: Array, step: float) -> Array:
        """Return how far torques move the joint from rest, (..., T) [rad].

        Steps are implicit, so that a stiff joint under a slow clock stays stable.

        Args:
            torques: At each step, (..., T) [N m].
            step: Time from one to the next [s].

        Example:
            >>> joint = JointResponse(inertia=0.1, damping=4.0, stiffness=50.0)
            >>> held = joint.positions(np.ones(2000), 0.002)
            >>> float(held[0]), round(float(held[-1]), 4)  # 1 N m / 50 N m/rad
            (0.0, 0.02)
        """
        from scipy.signal import lfilter  # half a second, where nothing is missing

        h, m, d, k = step, self.inertia, self.damping, self.stiffness
        # m (x - 2 x' + x'') / h^2 + d (x - x') / h + k x = torque, x' a step ago.
        past = [m / h**2 + d / h + k, -2.0 * m / h**2 - d / h, m / h**2]
        return np.asarray(lfilter([0.0, 1.0], past, torques, axis=-1))
