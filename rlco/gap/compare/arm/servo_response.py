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

        It is the exact answer to torques that change linearly between steps, so that
        these may be as long as a log's.

        Args:
            torques: At each step, (..., T) [N m].
            step: Time from one to the next [s].

        Example:
            >>> joint = JointResponse(inertia=0.1, damping=4.0, stiffness=50.0)
            >>> held = joint.positions(np.ones(2000), 0.002)
            >>> round(float(held[-1]), 4)  # 1 N m / 50 N m/rad
            0.02
        """
        from scipy import signal  # half a second, where nothing is missing

        motion = [1.0], [self.inertia, self.damping, self.stiffness]
        now, past, _ = signal.cont2discrete(motion, step, method="foh")
        return np.asarray(signal.lfilter(now.ravel(), past, torques, axis=-1))
