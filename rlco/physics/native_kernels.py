"""The compiled loops of the native backend: read, step and reset a range of copies.

Each takes the model's address and one row of field addresses a copy, and runs
without the GIL. What it computes between two MuJoCo calls is robosuite's
``OSC_POSE`` and its gripper, in robosuite's order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from rlco.physics.libmujoco import (
    doubles,
    mj_forward,
    mj_jacSite,
    mj_resetData,
    mj_step1,
    mj_step2,
)
from rlco.physics.osc import (
    NULL_STIFFNESS,
    joint_torques,
    orientation_error,
    robosuite_joint_torques,
    world_goal,
)

# Columns of the table of field addresses, one row a copy.
FIELDS = (
    "qpos",
    "qvel",
    "ctrl",
    "qfrc_bias",
    "qM",
    "site_xpos",
    "site_xmat",
    "xpos",
    "xquat",
    "mocap_pos",
)
_COLUMN = {name: i + 1 for i, name in enumerate(FIELDS)}  # 0: mjData itself
(_QPOS, _QVEL, _CTRL, _BIAS, _MASS, _SITE_POS, _SITE_MAT, _POS, _QUAT, _MOCAP) = (
    _COLUMN[name] for name in FIELDS
)
# Leading features of a copy: tool position, tool rotation, two fingers, joints.
OBJECTS = 3 + 9 + 2 + 7


@njit(nogil=True, cache=True)
def read_features(
    fields: Any, layout: Any, objects: Any, arm_qpos: Any, out: Any
) -> None:
    """Write one copy's features."""
    site, finger = layout[0], layout[1]
    out[0:3] = doubles(fields[_SITE_POS] + 24 * site, 3)
    out[3:12] = doubles(fields[_SITE_MAT] + 72 * site, 9)
    qpos = doubles(fields[_QPOS], layout[4])
    out[12] = qpos[finger]
    out[13] = qpos[finger + 1]
    for i in range(7):
        out[14 + i] = qpos[arm_qpos[i]]
    for k in range(objects.shape[0]):
        start = OBJECTS + 7 * k
        out[start : start + 3] = doubles(fields[_POS] + 24 * objects[k], 3)
        out[start + 3 : start + 7] = doubles(fields[_QUAT] + 32 * objects[k], 4)


@njit(nogil=True, cache=True)
def arm_mass(
    sparse: Any, arm_dof: Any, mass_address: Any, parent: Any, mass: Any
) -> None:
    """Write the arm's block of MuJoCo's sparse mass matrix, shape (n, n)."""
    n = arm_dof.shape[0]
    mass[:] = 0.0
    for i in range(n):
        # Row i holds itself, then its ancestors up the tree.
        dof, at = arm_dof[i], mass_address[arm_dof[i]]
        while dof >= 0:
            for j in range(i + 1):
                if arm_dof[j] == dof:
                    mass[i, j] = sparse[at]
                    mass[j, i] = sparse[at]
            dof = parent[dof]
            at += 1


@njit(nogil=True, cache=True)
def gripper_target(command: float, grip: Any, finger_range: Any, target: Any) -> None:
    """Move both fingers' goals a fifth towards open (-) or closed (+), as robosuite."""
    side = np.sign(command)
    grip[0] = min(max(grip[0] - 0.2 * side, -1.0), 1.0)
    grip[1] = min(max(grip[1] + 0.2 * side, -1.0), 1.0)
    for i in range(2):
        low, high = finger_range[i, 0], finger_range[i, 1]
        target[i] = 0.5 * (high + low) + 0.5 * (high - low) * grip[i]


@njit(nogil=True, cache=True)
def step_range(
    first: int,
    last: int,
    exact: bool,
    model: int,
    fields: Any,
    layout: Any,
    objects: Any,
    arm_qpos: Any,
    arm_dof: Any,
    mass_address: Any,
    parent: Any,
    arm_range: Any,
    finger_range: Any,
    gains: Any,
    base: Any,
    posture: Any,
    grip: Any,
    pending: Any,
    actions: Any,
    steps: Any,
    out: Any,
) -> None:
    """Execute `steps[e]` control steps of copies `first` to `last`."""
    site, arm_ctrl, finger_ctrl = layout[0], layout[2], layout[3]
    nq, nv, substeps = layout[4], layout[5], layout[6]
    n, delay = arm_dof.shape[0], pending.shape[1]
    mass = np.empty((n, n))
    jacobian = np.zeros((6, nv))
    arm_jacobian = np.empty((6, n))
    bias, torque, null = np.empty(n), np.empty(n), np.empty(n)
    now_qpos, now_qvel = np.empty(n), np.empty(n)
    wanted, velocity, error = np.empty(6), np.empty(6), np.empty(3)
    goal, goal_rotation = np.empty(3), np.empty((3, 3))
    stiffness, damping, scale = gains[:6], gains[6:12], gains[12:18]
    null_damping = 2.0 * np.sqrt(NULL_STIFFNESS)
    action = np.empty(actions.shape[2])
    target = np.empty(2)
    for e in range(first, last):
        f = fields[e]
        qpos, qvel = doubles(f[_QPOS], nq), doubles(f[_QVEL], nv)
        ctrl = doubles(f[_CTRL], finger_ctrl + 2)
        qfrc = doubles(f[_BIAS], nv)
        qm = doubles(f[_MASS], layout[7])
        tool = doubles(f[_SITE_POS] + 24 * site, 3)
        rotation = doubles(f[_SITE_MAT] + 72 * site, 9)
        for t in range(steps[e]):
            # The command that was given `delay` control steps ago.
            if delay:
                action[:] = pending[e, 0]
                for i in range(delay - 1):
                    pending[e, i] = pending[e, i + 1]
                pending[e, delay - 1] = actions[e, t]
            else:
                action[:] = actions[e, t]
            for s in range(substeps):
                mj_step1(model, f[0])
                mj_jacSite(
                    model, f[0], jacobian.ctypes.data, jacobian[3:].ctypes.data, site
                )
                if s == 0:
                    move = np.empty(6)
                    for i in range(6):
                        move[i] = min(max(action[i], -1.0), 1.0) * scale[i]
                    world_goal(base, tool, rotation, move, goal, goal_rotation)
                    gripper_target(action[6], grip[e], finger_range, target)
                for r in range(6):
                    for i in range(n):
                        arm_jacobian[r, i] = jacobian[r, arm_dof[i]]
                if exact:
                    velocity[:3] = np.dot(jacobian[:3], qvel)
                    velocity[3:] = np.dot(jacobian[3:], qvel)
                else:
                    for r in range(6):
                        velocity[r] = 0.0
                        for i in range(n):
                            velocity[r] += arm_jacobian[r, i] * qvel[arm_dof[i]]
                orientation_error(goal_rotation, rotation, error)
                for r in range(3):
                    wanted[r] = (goal[r] - tool[r]) * stiffness[r]
                    wanted[3 + r] = error[r] * stiffness[3 + r]
                for r in range(6):
                    wanted[r] -= velocity[r] * damping[r]
                arm_mass(qm, arm_dof, mass_address, parent, mass)
                for i in range(n):
                    bias[i] = qfrc[arm_dof[i]]
                    null[i] = (
                        NULL_STIFFNESS * (posture[e, i] - qpos[arm_qpos[i]])
                        - null_damping * qvel[arm_dof[i]]
                    )
                if exact:
                    for i in range(n):
                        now_qpos[i] = qpos[arm_qpos[i]]
                        now_qvel[i] = qvel[arm_dof[i]]
                    robosuite_joint_torques(
                        mass,
                        arm_jacobian,
                        bias,
                        wanted,
                        posture[e],
                        now_qpos,
                        now_qvel,
                        torque,
                    )
                else:
                    joint_torques(mass, arm_jacobian, bias, wanted, null, torque)
                for i in range(n):
                    low, high = arm_range[i, 0], arm_range[i, 1]
                    ctrl[arm_ctrl + i] = min(max(torque[i], low), high)
                ctrl[finger_ctrl] = target[0]
                ctrl[finger_ctrl + 1] = target[1]
                mj_step2(model, f[0])
            read_features(f, layout, objects, arm_qpos, out[e, t + 1])


@njit(nogil=True, cache=True)
def reset_range(
    which: Any,
    model: int,
    fields: Any,
    layout: Any,
    objects: Any,
    mocap: Any,
    object_joints: Any,
    arm_qpos: Any,
    joints: Any,
    poses: Any,
    goals: Any,
    out: Any,
) -> None:
    """Place robot, objects and marks of the copies `which`, and update the rest."""
    for row in range(which.shape[0]):
        e = which[row]
        f = fields[e]
        mj_resetData(model, f[0])
        qpos = doubles(f[_QPOS], layout[4])
        for i in range(arm_qpos.shape[0]):
            qpos[arm_qpos[i]] = joints[row, i]
        qpos[layout[1]] = 0.0
        qpos[layout[1] + 1] = 0.0
        for k in range(object_joints.shape[0]):
            qpos[object_joints[k] : object_joints[k] + 7] = poses[row, k]
        for k in range(mocap.shape[0]):
            doubles(f[_MOCAP] + 24 * mocap[k], 3)[:] = goals[row, k]
        mj_forward(model, f[0])
        read_features(f, layout, objects, arm_qpos, out[e])
