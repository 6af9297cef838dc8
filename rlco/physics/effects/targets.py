"""Possible targets of effects in a compiled model."""

from __future__ import annotations

import mujoco
import numpy as np

ONE_AXIS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of all hinges and slides."""
    return tuple(
        model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] in ONE_AXIS
    )


def driven_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of the joints that an actuator drives."""
    driven = {actuated_joint(model, actuator) for actuator in range(model.nu)}
    return tuple(name for name in joints(model) if name in driven)


def driven_hinges(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of the hinges that an actuator drives."""
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return tuple(n for n in driven_joints(model) if model.joint(n).type[0] == hinge)


def servo_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the joints whose actuator is commanded by a position."""
    names = [actuated_joint(model, a) for a in range(model.nu) if is_servo(model, a)]
    return tuple(name for name in joints(model) if name in names)


def is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Return whether an actuator pulls its joint to its command."""
    stiffness = -model.actuator_biasprm[actuator, 1]
    affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(affine and stiffness > 0)


def command_at(model: mujoco.MjModel, actuator: int) -> float:
    """Return a servo's command per unit of its joint's position; 1 of other actuators.

    It is 1 but for a gear, or a gain that is not the stiffness.

    Example:
        >>> model = mujoco.MjModel.from_xml_string(
        ...     "<mujoco><worldbody><body><joint name='j'/><geom size='0.1'/></body>"
        ...     "</worldbody><actuator><position joint='j' kp='40' gear='-2'/>"
        ...     "</actuator></mujoco>")
        >>> command_at(model, 0)
        -2.0
    """
    gain = float(model.actuator_gainprm[actuator, 0])
    if not is_servo(model, actuator) or gain == 0.0:
        return 1.0
    stiffness = -float(model.actuator_biasprm[actuator, 1])
    return float(model.actuator_gear[actuator, 0]) * (stiffness / gain)


def actuated_joint(model: mujoco.MjModel, actuator: int) -> str | None:
    """Return the name of the joint that an actuator drives, None if it drives none."""
    kind = model.actuator_trntype[actuator]
    if kind != mujoco.mjtTrn.mjTRN_JOINT:
        return None
    return str(model.joint(model.actuator_trnid[actuator, 0]).name)


def actuator_of(model: mujoco.MjModel, joint: str) -> int:
    """Return the index of the actuator that drives a joint, -1 if none does."""
    for actuator in range(model.nu):
        if actuated_joint(model, actuator) == joint:
            return actuator
    return -1


def moving_bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the bodies with mass that a hinge or slide moves."""
    return tuple(
        model.body(i).name
        for i in range(1, model.nbody)
        if model.body_mass[i] > 0 and model.body_weldid[i] != 0 and not _free(model, i)
    )


def last_links(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the links that can hold a payload: the last body of each chain."""
    parents = set(model.body_parentid[1:].tolist())
    return tuple(
        model.body(i).name
        for i in range(1, model.nbody)
        if i not in parents and model.body_weldid[i] != 0 and not _free(model, i)
    )


def free_bodies(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the bodies with a free joint."""
    return tuple(
        model.body(model.jnt_bodyid[i]).name
        for i in range(model.njnt)
        if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE
    )


def dof_of(model: mujoco.MjModel, joint: str) -> int:
    """Return a joint's (first) degree of freedom."""
    return int(model.jnt_dofadr[model.joint(joint).id])


def qpos_address(model: mujoco.MjModel, joint: str) -> int:
    """Return the address of a joint's (first) coordinate in ``qpos``."""
    return int(model.jnt_qposadr[model.joint(joint).id])


def holding_torque(model: mujoco.MjModel, joint: str) -> float:
    """Return a typical torque of a joint: the one that holds its links horizontal.

    Never below a hundredth of a newton metre (or newton, for a slide).
    """
    body = model.jnt_bodyid[model.joint(joint).id]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    below = model.body_subtreemass[body]
    arm = np.linalg.norm(data.subtree_com[body] - data.xanchor[model.joint(joint).id])
    gravity = float(np.linalg.norm(model.opt.gravity)) or 9.81
    inertia = data.qM[model.dof_Madr[dof_of(model, joint)]]
    return max(float(below * gravity * arm), 3.0 * float(inertia), 1e-2)


def motor_torque(model: mujoco.MjModel, joint: str) -> float:
    """Return the largest torque [N m, or N] a model lets a joint's motor have.

    0 where no motor drives the joint, or the model limits neither its torque nor the
    commands of a motor whose commands are torques.
    """
    actuator = actuator_of(model, joint)
    if actuator < 0:
        return 0.0
    gear = abs(float(model.actuator_gear[actuator, 0]))
    if model.actuator_forcelimited[actuator]:
        return gear * float(np.abs(model.actuator_forcerange[actuator]).max())
    fixed = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
    free = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    if not (model.actuator_ctrllimited[actuator] and fixed and free):
        return 0.0
    gain = abs(float(model.actuator_gainprm[actuator, 0]))
    return gear * gain * float(np.abs(model.actuator_ctrlrange[actuator]).max())


def _free(model: mujoco.MjModel, body: int) -> bool:
    root = int(model.body_rootid[body])
    first = int(model.body_jntadr[root])
    return first >= 0 and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE
