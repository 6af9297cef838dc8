"""Inverse dynamics along measured motions, compiled, without the GIL."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numba import njit

from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array
from rlco.physics.mj.libmujoco import mj_inverse


def inverse_dynamics(
    model: mujoco.MjModel, dofs: Integers, motion: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """Return the torques that a motion requires, and their static part.

    Args:
        model: Its other joints stay at the model's default positions.
        dofs: Degree of freedom of each joint of the motion; a hinge or a slide each.
        motion: Position, velocity and acceleration, (T, joints) each.

    Returns:
        Torques with damping and springs but without friction, (T, joints), and the
        part at zero acceleration without damping, (T, joints) [N m].

    Example:
        >>> model = mujoco.MjModel.from_xml_string(
        ...     "<mujoco><worldbody><body><joint axis='0 1 0' armature='0.5'/>"
        ...     "<inertial mass='2' pos='0.5 0 0' diaginertia='1 1 1'/></body>"
        ...     "</worldbody></mujoco>")
        >>> still, turning = np.zeros((1, 1)), np.ones((1, 1))
        >>> torque, load = inverse_dynamics(
        ...     model, np.array([0]), (still, still, turning))
        >>> # 0.5 + 1 + 2 * 0.5**2 kg m^2, and 2 * 9.81 * 0.5 N m of gravity.
        >>> torque.round(3), load.round(3)
        (array([[-7.81]]), array([[-9.81]]))
    """
    data = mujoco.MjData(model)
    joints = model.dof_jntid[dofs]
    columns = np.stack([model.jnt_qposadr[joints], dofs]).astype(np.int64)
    torque, load = np.empty_like(motion[0]), np.empty_like(motion[0])
    views = (data.qpos, data.qvel, data.qacc, data.qfrc_inverse, data.qfrc_bias)
    along = tuple(np.ascontiguousarray(part) for part in motion)
    _along(model._address, data._address, views, columns, along, torque, load)
    return torque, load


@njit(cache=True, nogil=True)
def _along(
    model: int,
    data: int,
    views: Any,
    columns: Any,
    motion: Any,
    torque: Any,
    load: Any,
) -> None:
    qpos, qvel, qacc, inverse, bias = views
    position, velocity, acceleration = motion
    for row in range(len(position)):
        for joint in range(columns.shape[1]):
            dof = columns[1, joint]
            qpos[columns[0, joint]] = position[row, joint]
            qvel[dof] = velocity[row, joint]
            qacc[dof] = acceleration[row, joint]
        mj_inverse(model, data)
        for joint in range(columns.shape[1]):
            torque[row, joint] = inverse[columns[1, joint]]
            load[row, joint] = bias[columns[1, joint]]
