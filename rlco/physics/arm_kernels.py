"""One control step of one copy, compiled: robosuite's controllers of an arm.

What runs between two MuJoCo calls is robosuite's ``OSC_POSE`` or ``JOINT_POSITION``
and its gripper, in robosuite's order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rlco.physics.arm_control import Array, Integers
from rlco.physics.libmujoco import doubles, mj_jacSite, mj_step1, mj_step2
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
    "mocap_quat",
)
_COLUMN = {name: i + 1 for i, name in enumerate(FIELDS)}  # 0: mjData itself
(QPOS, QVEL, CTRL, BIAS, MASS, SITE_POS, SITE_MAT, POS, QUAT) = (
    _COLUMN[name] for name in FIELDS[:9]
)
MOCAP_POS, MOCAP_QUAT = _COLUMN["mocap_pos"], _COLUMN["mocap_quat"]
# Beyond this, as MuJoCo has it, a number is as good as NaN (its mjMAXVAL).
TOO_LARGE = 1e10


class Memory(NamedTuple):
    """What each of N copies has of its own beside MuJoCo's state.

    With n arm joints, D numbers that command the arm, G actuators of the gripper,
    actions of A numbers and delays of at most L control steps.
    """

    models: Integers  # addresses of their models, (N,)
    fields: Integers  # addresses of their data and its arrays, (N, 1 + FIELDS)
    posture: Array  # where the null space pulls the arm, (N, n), [rad]
    grip: Array  # the gripper's goals in [-1, 1], (N, G)
    stiffness: Array  # (N, D)
    damping: Array  # (N, D)
    delay: Integers  # control steps between a command and its execution, (N,)
    pending: Array  # commands given and not yet executed, (N, L, A)
    broken: NDArray[np.bool_]  # diverged: not stepped until reset, (N,)
    fresh: NDArray[np.bool_]  # the next physics step takes the first matrices, (N,)
    first_mass: Array  # (N, n, n), see `set_first_matrices`
    first_jacobian: Array  # (N, 6, n)


class Scratch(NamedTuple):
    """Working space of one thread."""

    action: Array
    mass: Array
    jacobian: Array
    arm_jacobian: Array
    bias: Array
    torque: Array
    null: Array
    qpos: Array
    qvel: Array
    wanted: Array
    velocity: Array
    error: Array
    move: Array
    goal: Array
    goal_rotation: Array


@njit(nogil=True, cache=True)
def scratch(control: Any) -> Any:
    """Return working space for copies under this control."""
    n, moves = control.arm_dof.shape[0], control.inputs.shape[1]
    return Scratch(
        np.empty(moves + 1),
        np.empty((n, n)),
        np.zeros((6, control.nv)),
        np.empty((6, n)),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(6),
        np.empty(6),
        np.empty(3),
        np.empty(moves),
        np.empty(max(3, moves)),
        np.empty((3, 3)),
    )


@njit(nogil=True, cache=True)
def arm_mass(sparse: Any, control: Any, mass: Any) -> None:
    """Write the arm's block of MuJoCo's sparse mass matrix, shape (n, n)."""
    arm_dof = control.arm_dof
    n = arm_dof.shape[0]
    mass[:] = 0.0
    for i in range(n):
        # Row i holds itself, then its ancestors up the tree.
        dof, at = arm_dof[i], control.mass_address[arm_dof[i]]
        while dof >= 0:
            for j in range(i + 1):
                if arm_dof[j] == dof:
                    mass[i, j] = sparse[at]
                    mass[j, i] = sparse[at]
            dof = control.parent[dof]
            at += 1


@njit(nogil=True, cache=True)
def arm_columns(jacobian: Any, control: Any, out: Any) -> None:
    """Write the arm's columns of a Jacobian (6, nv), shape (6, n)."""
    for r in range(6):
        for i in range(control.arm_dof.shape[0]):
            out[r, i] = jacobian[r, control.arm_dof[i]]


@njit(nogil=True, cache=True)
def too_large(values: Any) -> bool:
    """Return whether any number is NaN or as good as that."""
    for value in values:  # noqa: SIM110 (numba knows no generators)
        if not abs(value) < TOO_LARGE:
            return True
    return False


@njit(nogil=True, cache=True)
def next_action(memory: Any, e: int, given: Any, action: Any) -> None:
    """Write the command that was given `delay` control steps ago; store this one."""
    delay = memory.delay[e]
    if delay == 0:
        action[: given.shape[0]] = given
        return
    pending = memory.pending[e]
    action[: given.shape[0]] = pending[0]
    for i in range(delay - 1):
        pending[i] = pending[i + 1]
    pending[delay - 1] = given


@njit(nogil=True, cache=True)
def set_goals(control: Any, memory: Any, e: int, s: Any) -> None:
    """Set the goals that a command asks for, of the arm and of the gripper."""
    f = memory.fields[e]
    moves = control.inputs.shape[1]
    for i in range(moves):
        low, high, middle = (
            control.inputs[0, i],
            control.inputs[1, i],
            control.inputs[2, i],
        )
        clipped = min(max(s.action[i], low), high)
        s.move[i] = (clipped - middle) * control.inputs[3, i] + control.inputs[4, i]
    if control.joint_position:
        qpos = doubles(f[QPOS], control.nq)
        for i in range(moves):
            s.goal[i] = qpos[control.arm_qpos[i]] + s.move[i]
    else:
        tool = doubles(f[SITE_POS] + 24 * control.site, 3)
        rotation = doubles(f[SITE_MAT] + 72 * control.site, 9)
        world_goal(
            control.base_frame,
            control.origin,
            tool,
            rotation,
            s.move,
            s.goal[:3],
            s.goal_rotation,
        )
    grip = memory.grip[e]
    if grip.shape[0]:
        side = np.sign(s.action[moves])
        for g in range(grip.shape[0]):
            grip[g] = min(max(grip[g] + control.finger_step[g] * side, -1.0), 1.0)


@njit(nogil=True, cache=True)
def joint_position_torques(control: Any, memory: Any, e: int, s: Any) -> None:
    """Write the torques of robosuite's ``JOINT_POSITION``."""
    n = s.torque.shape[0]
    for i in range(n):
        s.null[i] = (s.goal[i] - s.qpos[i]) * memory.stiffness[e, i] - (
            s.qvel[i] * memory.damping[e, i]
        )
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += s.mass[i, j] * s.null[j]
        s.torque[i] = total + s.bias[i]


@njit(nogil=True, cache=True)
def osc_pose_torques(control: Any, memory: Any, e: int, model: int, s: Any) -> None:
    """Write the torques of robosuite's ``OSC_POSE``."""
    f = memory.fields[e]
    n = s.torque.shape[0]
    tool = doubles(f[SITE_POS] + 24 * control.site, 3)
    rotation = doubles(f[SITE_MAT] + 72 * control.site, 9)
    qvel = doubles(f[QVEL], control.nv)
    mj_jacSite(
        model, f[0], s.jacobian.ctypes.data, s.jacobian[3:].ctypes.data, control.site
    )
    if memory.fresh[e]:
        s.arm_jacobian[:] = memory.first_jacobian[e]
    else:
        arm_columns(s.jacobian, control, s.arm_jacobian)
    if control.exact:
        s.velocity[:3] = np.dot(s.jacobian[:3], qvel)
        s.velocity[3:] = np.dot(s.jacobian[3:], qvel)
    else:
        for r in range(6):
            s.velocity[r] = 0.0
            for i in range(n):
                s.velocity[r] += s.arm_jacobian[r, i] * s.qvel[i]
    orientation_error(s.goal_rotation, rotation, s.error)
    stiffness, damping = memory.stiffness[e], memory.damping[e]
    for r in range(3):
        s.wanted[r] = (s.goal[r] - tool[r]) * stiffness[r]
        s.wanted[3 + r] = s.error[r] * stiffness[3 + r]
    for r in range(6):
        s.wanted[r] -= s.velocity[r] * damping[r]
    posture = memory.posture[e]
    if control.exact:
        robosuite_joint_torques(
            s.mass,
            s.arm_jacobian,
            s.bias,
            s.wanted,
            posture,
            s.qpos,
            s.qvel,
            s.torque,
        )
        return
    null_damping = 2.0 * np.sqrt(NULL_STIFFNESS)
    for i in range(n):
        s.null[i] = NULL_STIFFNESS * (posture[i] - s.qpos[i]) - null_damping * s.qvel[i]
    joint_torques(s.mass, s.arm_jacobian, s.bias, s.wanted, s.null, s.torque)


@njit(nogil=True, cache=True)
def control_step(control: Any, memory: Any, e: int, given: Any, s: Any) -> bool:
    """Execute one control step of a copy; return whether its state is sound."""
    model, f = memory.models[e], memory.fields[e]
    n = control.arm_dof.shape[0]
    qpos, qvel = doubles(f[QPOS], control.nq), doubles(f[QVEL], control.nv)
    ctrl = doubles(f[CTRL], control.nu)
    qfrc, qm = doubles(f[BIAS], control.nv), doubles(f[MASS], control.nm)
    next_action(memory, e, given, s.action)
    for step in range(control.substeps):
        # Here rather than by MuJoCo's warnings: LAPACK refuses NaN.
        if too_large(qpos) or too_large(qvel):
            return False
        mj_step1(model, f[0])
        if step == 0:
            set_goals(control, memory, e, s)
        if memory.fresh[e]:
            s.mass[:] = memory.first_mass[e]
        else:
            arm_mass(qm, control, s.mass)
        for i in range(n):
            s.bias[i] = qfrc[control.arm_dof[i]]
            s.qpos[i] = qpos[control.arm_qpos[i]]
            s.qvel[i] = qvel[control.arm_dof[i]]
        if control.joint_position:
            joint_position_torques(control, memory, e, s)
        else:
            osc_pose_torques(control, memory, e, model, s)
        memory.fresh[e] = False
        if too_large(s.torque):
            return False
        for i in range(n):
            low, high = control.arm_range[i, 0], control.arm_range[i, 1]
            ctrl[control.arm_ctrl[i]] = min(max(s.torque[i], low), high)
        for g in range(control.finger_ctrl.shape[0]):
            low, high = control.finger_range[g, 0], control.finger_range[g, 1]
            target = 0.5 * (high + low) + 0.5 * (high - low) * memory.grip[e, g]
            ctrl[control.finger_ctrl[g]] = min(max(target, low), high)
        mj_step2(model, f[0])
    return not (too_large(qpos) or too_large(qvel))
