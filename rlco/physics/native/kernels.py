"""The compiled loops of the native backend: read, step and reset a range of worlds.

Each takes one row of addresses per world, and runs without the GIL.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from rlco.physics.mj.compiling import inner
from rlco.physics.mj.copying import copy_into
from rlco.physics.mj.libmujoco import (
    doubles,
    mj_comPos,
    mj_forward,
    mj_jacSite,
    mj_kinematics,
    mj_makeM,
    mj_resetData,
)
from rlco.physics.native.arm_kernels import arm_columns, arm_mass, control_step
from rlco.physics.native.world_memory import (
    MASS,
    MOCAP_POS,
    MOCAP_QUAT,
    POS,
    QPOS,
    QUAT,
    SITE_MAT,
    SITE_POS,
    scratch,
)
from rlco.physics.spec.control import Integers

# Offsets of a world's features: tool position, tool rotation, two fingers, the arm's
# joints. A pose for each tracked body follows, then a number for each fixture's joint.
TOOL, TURN, FINGERS, JOINTS = 0, 3, 12, 14
POSE_SIZE = 7  # position and quaternion


class Tracked(NamedTuple):
    """Addresses from which a task's features are read."""

    site: int  # the tool
    finger: int  # qpos of the first of two fingers
    nq: int
    arm_qpos: Integers  # (n,)
    objects: Integers  # bodies of objects, then of fixtures, (K + F,)
    object_joints: Integers  # first qpos of each object's joint, (K,)
    mocap: Integers  # marks, (G,)
    fixture_qpos: Integers  # qpos of each joint of a fixture, (J,)


def feature_count(tracked: Tracked) -> int:
    """Return the number of features of a world."""
    arm, bodies = tracked.arm_qpos.size, tracked.objects.size
    return JOINTS + arm + POSE_SIZE * bodies + tracked.fixture_qpos.size


@inner
def read_features(fields: Any, tracked: Any, out: Any) -> None:
    """Write one world's features."""
    copy_into(out, TOOL, doubles(fields[SITE_POS] + 24 * tracked.site, 3))
    copy_into(out, TURN, doubles(fields[SITE_MAT] + 72 * tracked.site, 9))
    qpos = doubles(fields[QPOS], tracked.nq)
    out[FINGERS] = qpos[tracked.finger]
    out[FINGERS + 1] = qpos[tracked.finger + 1]
    start = JOINTS
    for i in range(tracked.arm_qpos.shape[0]):
        out[start + i] = qpos[tracked.arm_qpos[i]]
    start += tracked.arm_qpos.shape[0]
    for k in range(tracked.objects.shape[0]):
        body = tracked.objects[k]
        copy_into(out, start, doubles(fields[POS] + 24 * body, 3))
        copy_into(out, start + 3, doubles(fields[QUAT] + 32 * body, 4))
        start += POSE_SIZE
    for j in range(tracked.fixture_qpos.shape[0]):
        out[start + j] = qpos[tracked.fixture_qpos[j]]


@njit(nogil=True, cache=True)
def advance_range(
    first: int, last: int, control: Any, memory: Any, actions: Any, steps: Any
) -> None:
    """Execute `steps[e]` control steps of worlds `first` to `last`."""
    s = scratch(control)
    for e in range(first, last):
        for t in range(steps[e]):
            if memory.broken[e]:
                break
            memory.broken[e] = not control_step(control, memory, e, actions[e, t], s)


@njit(nogil=True, cache=True)
def step_range(
    first: int,
    last: int,
    control: Any,
    memory: Any,
    tracked: Any,
    actions: Any,
    steps: Any,
    out: Any,
) -> None:
    """Execute `steps[e]` control steps of worlds `first` to `last`, reading features.

    Rows after the last valid step of a world repeat it.
    """
    s = scratch(control)
    for e in range(first, last):
        done = 0
        for t in range(steps[e]):
            if memory.broken[e]:
                break
            memory.broken[e] = not control_step(control, memory, e, actions[e, t], s)
            if not memory.broken[e]:
                read_features(memory.fields[e], tracked, out[e, t + 1])
                done = t + 1
        for t in range(done, out.shape[1] - 1):
            copy_into(out[e, t + 1], 0, out[e, done])


@njit(nogil=True, cache=True)
def clear_range(which: Any, memory: Any) -> None:
    """Reset the states of the worlds `which` to the model's defaults."""
    for row in range(which.shape[0]):
        mj_resetData(memory.models[which[row]], memory.fields[which[row], 0])


@njit(nogil=True, cache=True)
def set_first_matrices(which: Any, control: Any, memory: Any, qpos0: Any) -> None:
    """Make the next physics step of the worlds `which` start as robosuite's does.

    At a reset robosuite computes the arm's mass matrix and Jacobian after it places the
    arm, but before it places anything else, including the gripper. Its controller uses
    them in the first physics step. It also shifts the first joint positions by 1e-7
    rad.
    """
    before = np.empty(control.nq)
    jacobian = np.empty((6, control.nv))
    for row in range(which.shape[0]):
        e = which[row]
        model, f = memory.models[e], memory.fields[e]
        qpos = doubles(f[QPOS], control.nq)
        copy_into(before, 0, qpos)
        copy_into(qpos, 0, qpos0)
        for i in control.arm_qpos:
            qpos[i] = before[i]
        mj_kinematics(model, f[0])
        mj_comPos(model, f[0])
        mj_makeM(model, f[0])
        arm_mass(doubles(f[MASS], control.nm), control, memory.first_mass[e])
        mj_jacSite(
            model, f[0], jacobian.ctypes.data, jacobian[3:].ctypes.data, control.site
        )
        arm_columns(jacobian, control, memory.first_jacobian[e])
        memory.fresh[e] = True
        copy_into(qpos, 0, before)


@njit(nogil=True, cache=True)
def forward_range(which: Any, memory: Any) -> None:
    """Compute all quantities that depend on the positions of the worlds `which`."""
    for row in range(which.shape[0]):
        mj_forward(memory.models[which[row]], memory.fields[which[row], 0])


@njit(nogil=True, cache=True)
def reset_range(
    which: Any,
    memory: Any,
    tracked: Any,
    joints: Any,
    fingers: Any,
    poses: Any,
    goals: Any,
    openings: Any,
    out: Any,
) -> None:
    """Place robot, objects and marks of the worlds `which`, and update the rest."""
    clear_range(which, memory)
    for row in range(which.shape[0]):
        f = memory.fields[which[row]]
        qpos = doubles(f[QPOS], tracked.nq)
        for i in range(tracked.arm_qpos.shape[0]):
            qpos[tracked.arm_qpos[i]] = joints[row, i]
        qpos[tracked.finger] = fingers[row]
        qpos[tracked.finger + 1] = -fingers[row]
        for k in range(tracked.object_joints.shape[0]):
            first = tracked.object_joints[k]
            copy_into(qpos, first, poses[row, k])
        for k in range(tracked.mocap.shape[0]):
            mark = tracked.mocap[k]
            copy_into(doubles(f[MOCAP_POS] + 24 * mark, 3), 0, goals[row, k, :3])
            copy_into(doubles(f[MOCAP_QUAT] + 32 * mark, 4), 0, goals[row, k, 3:])
        for j in range(tracked.fixture_qpos.shape[0]):
            qpos[tracked.fixture_qpos[j]] = openings[row, j]
    forward_range(which, memory)
    for row in range(which.shape[0]):
        read_features(memory.fields[which[row]], tracked, out[which[row]])
