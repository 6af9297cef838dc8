"""Stability of a joint's servo: its largest stable time step, and missing inertia."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.compare.arm.divergence import is_implicit
from rlco.gap.logs.log import Array


@dataclass(frozen=True)
class JointServo:
    """Stiffness, damping and inertia of a joint, as one degree of freedom.

    Attributes:
        stiffness: Of servo and spring [N m/rad].
        braking: Damping of servo and joint [N m s/rad].
        stepped: The part of the damping that the integrator treats explicitly, at the
            velocity before the step [N m s/rad].
        inertia: At the joint, with all other joints free [kg m^2].
    """

    stiffness: float
    braking: float
    stepped: float
    inertia: float

    @property
    def critical(self) -> float:
        """The largest stable time step [s].

        Semi-implicit Euler, ``(I + h a) v' = (I - h e) v - h k x``, ``x' = x + h v'``,
        has both roots within the unit circle if
        ``k h^2 < 4 I + 2 h (a - e)``, by Jury's criterion.

        Example:
            >>> # An undamped spring: 2 over its angular frequency.
            >>> JointServo(4.0, 0.0, 0.0, 1.0).critical
            1.0
        """
        k, ahead = self.stiffness, self.braking - 2.0 * self.stepped
        if k <= 0.0:
            return -2.0 * self.inertia / ahead if ahead < 0.0 else math.inf
        return (ahead + math.sqrt(max(ahead**2 + 4.0 * k * self.inertia, 0.0))) / k

    def lacking(self, timestep: float) -> float:
        """Return the additional inertia that makes a time step stable.

        Example:
            >>> JointServo(4.0, 0.0, 0.0, 1.0).lacking(2.0)
            3.0
        """
        ahead = self.braking - 2.0 * self.stepped
        least = 0.25 * (self.stiffness * timestep**2 - 2.0 * timestep * ahead)
        return max(0.0, least - self.inertia)


def joint_servo(model: mujoco.MjModel, qpos: Array, joint: str) -> JointServo:
    """Return stiffness, damping and inertia of a hinge or slide.

    Args:
        model: The model.
        qpos: Positions at which its inertia is evaluated, (nq,).
        joint: The joint's name.
    """
    index = model.joint(joint).id
    dof = int(model.jnt_dofadr[index])
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    unit, moved = np.zeros((1, model.nv)), np.zeros((1, model.nv))
    unit[0, dof] = 1.0
    mujoco.mj_solveM(model, data, moved, unit)
    pulls, brakes = float(model.jnt_stiffness[index]), float(model.dof_damping[dof])
    stepped = 0.0
    for actuator in range(model.nu):
        driven = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        if driven and affine and model.actuator_trnid[actuator, 0] == index:
            gear = float(model.actuator_gear[actuator, 0]) ** 2
            pulls -= gear * float(model.actuator_biasprm[actuator, 1])
            stepped -= gear * float(model.actuator_biasprm[actuator, 2])
    brakes += stepped
    if is_implicit(model):
        stepped = 0.0
    elif model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP:
        stepped = brakes
    return JointServo(pulls, brakes, stepped, 1.0 / float(moved[0, dof]))
