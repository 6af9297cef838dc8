"""One control step of one world, compiled: robosuite's controllers of an arm.

Between two MuJoCo calls it computes robosuite's ``OSC_POSE`` or ``JOINT_POSITION`` and
its gripper, in robosuite's order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
from rlco.physics.mj.copying import copy_into, copy_matrix
from rlco.physics.mj.libmujoco import doubles, mj_jacSite, mj_step1, mj_step2
from rlco.physics.native.effect_kernels import (
    goal_is_due,
    lag_behind,
    observe,
    send,
    write_friction,
    write_torques,
)
from rlco.physics.native.osc import (
    NULL_STIFFNESS,
    joint_torques,
    orientation_error,
    robosuite_joint_torques,
    world_goal,
)
from rlco.physics.native.world_memory import (
    BIAS,
    CTRL,
    MASS,
    QPOS,
    QVEL,
    SITE_MAT,
    SITE_POS,
)
from rlco.physics.spec.stepper import TOO_LARGE


@inner
def arm_mass(sparse: Any, control: Any, mass: Any) -> None:
    """Write the arm's block of MuJoCo's sparse mass matrix, shape (n, n)."""
    arm_dof = control.arm_dof
    n = arm_dof.shape[0]
    mass[:] = 0.0
    for i in range(n):
        # Row i contains itself, then its ancestors up the tree.
        dof, at = arm_dof[i], control.mass_address[arm_dof[i]]
        while dof >= 0:
            for j in range(i + 1):
                if arm_dof[j] == dof:
                    mass[i, j] = sparse[at]
                    mass[j, i] = sparse[at]
            dof = control.parent[dof]
            at += 1


@inner
def arm_columns(jacobian: Any, control: Any, out: Any) -> None:
    """Write the arm's columns of a Jacobian (6, nv), shape (6, n)."""
    for r in range(6):
        for i in range(control.arm_dof.shape[0]):
            out[r, i] = jacobian[r, control.arm_dof[i]]


@inner
def too_large(values: Any) -> bool:
    """Return whether any value is NaN or too large to be valid."""
    for value in values:  # noqa: SIM110 (numba does not support generators)
        if not abs(value) < TOO_LARGE:
            return True
    return False


@inner
def next_action(memory: Any, e: int, whole: int, given: Any, action: Any) -> None:
    """Write the command to execute now, and store the given one.

    The delay is the world's own `delay` plus `whole`, in control steps.
    """
    delay = memory.delay[e] + whole
    if delay == 0:
        copy_into(action, 0, given)
        return
    pending = memory.pending[e]
    copy_into(action, 0, pending[0])
    for i in range(delay - 1):
        copy_into(pending[i], 0, pending[i + 1])
    copy_into(pending[delay - 1], 0, given)


@inner
def set_goals(control: Any, memory: Any, e: int, s: Any) -> None:
    """Set the goals of the arm and of the gripper for a command."""
    f, action = memory.observed[e], memory.action[e]
    moves = control.inputs.shape[1]
    for i in range(moves):
        low, high, middle = (
            control.inputs[0, i],
            control.inputs[1, i],
            control.inputs[2, i],
        )
        clipped = min(max(action[i], low), high)
        s.move[i] = (clipped - middle) * control.inputs[3, i] + control.inputs[4, i]
    if control.joint_position:
        qpos = doubles(f[QPOS], control.nq)
        for i in range(moves):
            memory.goal[e, i] = qpos[control.arm_qpos[i]] + s.move[i]
    else:
        tool = doubles(f[SITE_POS] + 24 * control.site, 3)
        rotation = doubles(f[SITE_MAT] + 72 * control.site, 9)
        world_goal(
            control.base_frame,
            control.origin,
            tool,
            rotation,
            s.move,
            memory.goal[e, :3],
            memory.goal_rotation[e],
        )
    grip = memory.grip[e]
    if grip.shape[0]:
        side = np.sign(action[moves])
        for g in range(grip.shape[0]):
            grip[g] = min(max(grip[g] + control.finger_step[g] * side, -1.0), 1.0)


@inner
def joint_position_torques(control: Any, memory: Any, e: int, s: Any) -> None:
    """Write the torques of robosuite's ``JOINT_POSITION``."""
    n, goal = s.torque.shape[0], memory.goal[e]
    for i in range(n):
        s.null[i] = (goal[i] - s.qpos[i]) * memory.stiffness[e, i] - (
            s.qvel[i] * memory.damping[e, i]
        )
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += s.mass[i, j] * s.null[j]
        s.torque[i] = total + s.bias[i]


@inner
def osc_pose_torques(control: Any, memory: Any, e: int, model: int, s: Any) -> None:
    """Write the torques of robosuite's ``OSC_POSE``."""
    f, goal = memory.observed[e], memory.goal[e]
    n = s.torque.shape[0]
    tool = doubles(f[SITE_POS] + 24 * control.site, 3)
    rotation = doubles(f[SITE_MAT] + 72 * control.site, 9)
    qvel = doubles(f[QVEL], control.nv)
    mj_jacSite(
        model, f[0], s.jacobian.ctypes.data, s.jacobian[3:].ctypes.data, control.site
    )
    if memory.fresh[e]:
        copy_matrix(s.arm_jacobian, memory.first_jacobian[e])
    else:
        arm_columns(s.jacobian, control, s.arm_jacobian)
    if control.exact:
        copy_into(s.velocity, 0, np.dot(s.jacobian[:3], qvel))
        copy_into(s.velocity, 3, np.dot(s.jacobian[3:], qvel))
    else:
        for r in range(6):
            s.velocity[r] = 0.0
            for i in range(n):
                s.velocity[r] += s.arm_jacobian[r, i] * s.qvel[i]
    orientation_error(memory.goal_rotation[e], rotation, s.error)
    stiffness, damping = memory.stiffness[e], memory.damping[e]
    for r in range(3):
        s.wanted[r] = (goal[r] - tool[r]) * stiffness[r]
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


@inner
def control_step(control: Any, memory: Any, e: int, given: Any, s: Any) -> bool:
    """Execute one control step of a world; return whether its state is valid."""
    acting, model, f = control.acting, memory.models[e], memory.fields[e]
    # The controller observes the state itself, except for effects unknown to it.
    observed, controller_model = memory.observed[e], acting.controller_model or model
    n = control.arm_dof.shape[0]
    qpos, qvel = doubles(f[QPOS], control.nq), doubles(f[QVEL], control.nv)
    reported, reported_speed = (
        doubles(observed[QPOS], control.nq),
        doubles(observed[QVEL], control.nv),
    )
    ctrl = doubles(f[CTRL], control.nu)
    qfrc, qm = doubles(observed[BIAS], control.nv), doubles(observed[MASS], control.nm)
    if acting.random.shape[0]:
        send(control, memory, e, given)
    else:
        next_action(memory, e, acting.whole, given, s.action)
    for step in range(control.substeps):
        # Checked here, not by MuJoCo's warnings: LAPACK rejects NaN.
        if too_large(qpos) or too_large(qvel):
            return False
        if acting.forces.friction.rows.shape[0]:
            write_friction(control, memory, e)
        mj_step1(model, f[0])
        if acting.controller_model:
            observe(control, memory, e)
        if goal_is_due(control, memory, e, step, s.action):
            set_goals(control, memory, e, s)
        if memory.fresh[e]:
            copy_matrix(s.mass, memory.first_mass[e])
        else:
            arm_mass(qm, control, s.mass)
        for i in range(n):
            s.bias[i] = qfrc[control.arm_dof[i]]
            s.qpos[i] = reported[control.arm_qpos[i]]
            s.qvel[i] = reported_speed[control.arm_dof[i]]
        if control.joint_position:
            joint_position_torques(control, memory, e, s)
        else:
            osc_pose_torques(control, memory, e, controller_model, s)
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
        if acting.lags:
            lag_behind(control, memory, e, ctrl)
        if acting.forces.torque.rows.shape[0]:
            write_torques(control, memory, e)
        mj_step2(model, f[0])
        memory.clock[e] += 1
    return not (too_large(qpos) or too_large(qvel))
