"""What effects do in one physics step of one copy, compiled.

`rlco.physics.effect_sim` does the same to robosuite's own environments, in the same
order, and a test compares the two.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from rlco.physics.copy_memory import ACTUATION, APPLIED, BIAS, QPOS, QVEL
from rlco.physics.libmujoco import (
    doubles,
    mj_comPos,
    mj_comVel,
    mj_kinematics,
    mj_makeM,
    mj_rne,
)


@njit(nogil=True, cache=True)
def add_step_terms(control: Any, memory: Any, e: int) -> None:
    """Set friction and lost torque of the next physics step.

    They follow from the forces at the end of the step before it, as friction models on
    top of an engine do (BAM, arXiv 2410.08650).
    """
    acting, f = control.acting, memory.fields[e]
    friction = doubles(memory.friction[e], control.nv)
    qvel, bias = doubles(f[QVEL], control.nv), doubles(f[BIAS], control.nv)
    actuation = doubles(f[ACTUATION], control.nv)
    applied = doubles(f[APPLIED], control.nv)
    for d in range(control.nv):
        carried = abs(actuation[d] + applied[d] + bias[d])
        stribeck = acting.static[d] * np.exp(-((qvel[d] / acting.speed[d]) ** 2))
        friction[d] = memory.coulomb[e, d] + stribeck + acting.load[d] * carried
        applied[d] = 0.0
    for a in range(control.nu):
        d = acting.dofs[a]
        if acting.drive[a] > 0.0 and d >= 0:
            torque = actuation[d]
            kept = 1.0 / (1.0 + acting.drive[a] * abs(torque))
            applied[d] -= (1.0 - kept) * torque


@njit(nogil=True, cache=True)
def look(control: Any, memory: Any, e: int) -> None:
    """Compute what the controller takes the robot's state to be.

    Positions and velocities are those that the encoders tell; kinematics, inertia and
    bias forces follow by the model without effects.
    """
    acting, f, seen = control.acting, memory.fields[e], memory.seen[e]
    qpos, told = doubles(f[QPOS], control.nq), doubles(seen[QPOS], control.nq)
    for i in range(control.nq):
        told[i] = acting.told[0, i] * qpos[i] + acting.told[1, i]
    qvel, speed = doubles(f[QVEL], control.nv), doubles(seen[QVEL], control.nv)
    for d in range(control.nv):
        speed[d] = acting.told_speed[d] * qvel[d]
    mj_kinematics(acting.believed, seen[0])
    mj_comPos(acting.believed, seen[0])
    mj_makeM(acting.believed, seen[0])
    mj_comVel(acting.believed, seen[0])
    mj_rne(acting.believed, seen[0], 0, seen[BIAS])


@njit(nogil=True, cache=True)
def look_range(which: Any, control: Any, memory: Any) -> None:
    """Compute what the controllers of the copies `which` take their states to be."""
    if control.acting.believed:
        for row in range(which.shape[0]):
            look(control, memory, which[row])


@njit(nogil=True, cache=True)
def goal_is_due(control: Any, memory: Any, e: int, step: int, action: Any) -> bool:
    """Return whether the controller reads a new command in this physics step.

    Args:
        control: The controller.
        memory: Of all copies.
        e: The copy.
        step: Physics step of the control step.
        action: The command that arrives in this control step.
    """
    acting, clock = control.acting, memory.clock[e]
    if step == acting.phase:
        memory.action[e] = action
        memory.unread[e] = True
    due = bool(memory.unread[e])
    if acting.period > 0.0:
        # Since when it counts its periods, as commands are read before they travel.
        since = clock - acting.whole * control.substeps - acting.phase
        now = np.floor(since / acting.period + 1e-9)
        due = due and bool(now > np.floor((since - 1) / acting.period + 1e-9))
    # A robot that no command has reached yet holds its place.
    due = due or bool(clock == 0)
    memory.unread[e] = memory.unread[e] and not due
    return due


@njit(nogil=True, cache=True)
def lag_behind(control: Any, memory: Any, e: int, ctrl: Any) -> None:
    """Let lagging actuators go a part of the way to their commands."""
    lag, reached = control.acting.lag, memory.ctrl[e]
    for a in range(control.nu):
        if lag[a] < 1.0 and memory.clock[e] > 0:
            reached[a] += lag[a] * (ctrl[a] - reached[a])
            ctrl[a] = reached[a]
        else:
            reached[a] = ctrl[a]
