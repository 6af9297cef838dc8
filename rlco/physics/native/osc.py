"""Operational-space control as robosuite computes it, compiled.

Khatib, "A unified approach for motion and force control of robot manipulators:
the operational space formulation", IEEE J. Robotics and Automation 3(1), 1987.
robosuite's variant (its ``OSC_POSE``): position and orientation uncoupled, gravity
compensated, null space attracted to the initial posture. The order of operations is the
same where rounding matters, so that both backends give the same motion up to rounding,
and with ``exact=True`` to the last bit.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rlco.physics.mj.compiling import inner
from rlco.physics.mj.copying import copy_into, copy_matrix
from rlco.physics.robosuite.robosuite_api import nullspace_torques, opspace_matrices

Array = NDArray[np.float64]

NULL_STIFFNESS = 10.0  # of robosuite's null-space posture task [1/s^2]


@njit(cache=True)
def delta_rotation(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector [rad], shape (3, 3).

    robosuite rounds the quaternion to float32 on the way, and so does this.
    """
    angle = np.sqrt(np.dot(vector, vector))
    if angle == 0.0:
        return np.eye(3)
    q = np.zeros(4, dtype=np.float32)
    axis = vector / angle
    q[0] = np.cos(angle / 2.0)
    for i in range(3):
        q[1 + i] = axis[i] * np.sin(angle / 2.0)
    q *= np.sqrt(2.0 / np.dot(q, q))
    p = np.outer(q, q)
    rotation = np.empty((3, 3))
    rotation[0, 0] = 1.0 - p[2, 2] - p[3, 3]
    rotation[0, 1] = p[1, 2] - p[3, 0]
    rotation[0, 2] = p[1, 3] + p[2, 0]
    rotation[1, 0] = p[1, 2] + p[3, 0]
    rotation[1, 1] = 1.0 - p[1, 1] - p[3, 3]
    rotation[1, 2] = p[2, 3] - p[1, 0]
    rotation[2, 0] = p[1, 3] - p[2, 0]
    rotation[2, 1] = p[2, 3] + p[1, 0]
    rotation[2, 2] = 1.0 - p[1, 1] - p[2, 2]
    return rotation


@inner
def world_goal(
    base_frame: bool,
    base: Array,
    tool: Array,
    rotation: Array,
    move: Array,
    goal: Array,
    turned: Array,
) -> None:
    """Write the tool pose that a delta command requests, in the world frame.

    Deltas are relative to the pose reached.

    Args:
        base_frame: Whether deltas are along the axes of the controller's base, or the
            world's.
        base: Position (3) and rotation (9) of the controller's base, [m].
        tool: Tool position, shape (3,), [m].
        rotation: Tool rotation, shape (9,).
        move: Commanded delta position and rotation vector, shape (6,), [m, rad].
        goal: Output: position, shape (3,), [m].
        turned: Output: rotation, shape (3, 3).
    """
    if not base_frame:
        copy_into(goal, 0, tool + move[:3])
        moved = np.dot(delta_rotation(move[3:].copy()), rotation.copy().reshape(3, 3))
        copy_matrix(turned, moved)
        return
    frame = base[3:].copy().reshape(3, 3)
    inverse, pose = np.eye(4), np.eye(4)
    copy_matrix(inverse, frame.T)
    copy_into(inverse[:, 3], 0, np.dot(-frame.T, base[:3]))
    copy_into(pose[:, 3], 0, tool)
    copy_into(goal, 0, np.dot(inverse, pose)[:3, 3] + move[:3])
    copy_into(goal, 0, base[:3] + np.dot(frame, goal))
    copy_matrix(pose, rotation.copy().reshape(3, 3))
    local = np.dot(inverse, pose)[:3, :3].copy()
    copy_matrix(turned, np.dot(frame, np.dot(delta_rotation(move[3:].copy()), local)))


@inner
def _factor(a: Array, n: int) -> None:
    """Cholesky-factor the leading n x n block of a symmetric matrix in place."""
    for j in range(n):
        for k in range(j):
            for i in range(j, n):
                a[i, j] -= a[i, k] * a[j, k]
        scale = 1.0 / np.sqrt(a[j, j])
        for i in range(j, n):
            a[i, j] *= scale


@inner
def _solve(factor: Array, x: Array, n: int) -> None:
    """Solve with a Cholesky factor in place."""
    for i in range(n):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]


@njit(cache=True)
def joint_torques(
    mass: Array,
    jacobian: Array,
    bias: Array,
    acceleration: Array,
    null_acceleration: Array,
    torque: Array,
) -> None:
    r"""Write the arm's torques for a desired tool acceleration.

    With mass matrix :math:`M`, Jacobian :math:`J`, bias forces :math:`h` and
    :math:`\Lambda = (J M^{-1} J^T)^{-1}` (and its position and rotation blocks):

    .. math:: \tau = J^T [\Lambda_p a_p; \Lambda_r a_r] + h
              + M \ddot q_0 - J^T \Lambda J \ddot q_0

    Args:
        mass: :math:`M`, shape (n, n), [kg m^2]; overwritten.
        jacobian: :math:`J`, shape (6, n): position rows, then rotation rows.
        bias: :math:`h`, shape (n,), [N m].
        acceleration: Desired :math:`a`, shape (6,), [m/s^2, rad/s^2]; overwritten.
        null_acceleration: Desired :math:`\ddot q_0` of the posture, shape (n,).
        torque: Output, shape (n,), [N m].
    """
    n = mass.shape[0]
    # J qdd0 and M qdd0 before M is overwritten by its factor.
    wrench = np.zeros(6)
    for i in range(n):
        total = bias[i]
        for j in range(n):
            total += mass[i, j] * null_acceleration[j]
        torque[i] = total
    for r in range(6):
        for j in range(n):
            wrench[r] += jacobian[r, j] * null_acceleration[j]
    # J M^-1 J^T = Y^T Y with Y = L^-1 J^T.
    _factor(mass, n)
    y = np.empty((6, n))
    for r in range(6):
        for i in range(n):
            total = jacobian[r, i]
            for k in range(i):
                total -= mass[i, k] * y[r, k]
            y[r, i] = total / mass[i, i]
    full = np.empty((6, 6))
    position = np.empty((3, 3))
    rotation = np.empty((3, 3))
    for r in range(6):
        for c in range(r + 1):
            total = 0.0
            for k in range(n):
                total += y[r, k] * y[c, k]
            full[r, c] = total
            if r < 3:
                position[r, c] = total
            elif c >= 3:
                rotation[r - 3, c - 3] = total
    _factor(full, 6)
    _factor(position, 3)
    _factor(rotation, 3)
    _solve(full, wrench, 6)
    _solve(position, acceleration[:3], 3)
    _solve(rotation, acceleration[3:], 3)
    for i in range(n):
        for r in range(6):
            torque[i] += jacobian[r, i] * (acceleration[r] - wrench[r])


@njit(cache=True)
def orientation_error(desired: Array, current: Array, error: Array) -> None:
    """Write half the sum of the axes' cross products, (3,), [rad]; (3, 3) and (9,)."""
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        total = 0.0
        for k in range(3):
            total += (
                current[3 * b + k] * desired[c, k] - current[3 * c + k] * desired[b, k]
            )
        error[a] = 0.5 * total


@njit(cache=True)
def robosuite_joint_torques(
    mass: Array,
    jacobian: Array,
    bias: Array,
    acceleration: Array,
    posture: Array,
    position: Array,
    velocity: Array,
    torque: Array,
) -> None:
    """Write the same torques with robosuite's own compiled linear algebra.

    It is slower (two inverses and three singular value decompositions per physics
    step), but avoids the rounding differences of 1e-12 between the two, which an impact
    can magnify. Arguments as in `joint_torques`; the posture task is given by the
    posture, the joint positions and velocities, each shape (n,).
    """
    top, bottom = jacobian[:3].copy(), jacobian[3:].copy()
    _, position_inertia, rotation_inertia, null = opspace_matrices(
        mass.T, jacobian, top, bottom
    )
    wrench = np.concatenate(
        (
            np.dot(position_inertia, acceleration[:3]),
            np.dot(rotation_inertia, acceleration[3:]),
        )
    )
    copy_into(torque, 0, np.dot(jacobian.T, wrench) + bias)
    torque += nullspace_torques(
        mass.T, null, posture, position, velocity, NULL_STIFFNESS
    )
