"""Effects in one physics step of one world, compiled.

`rlco.physics.robosuite.effect_sim` does the same for robosuite's own environments, in
the same order and by the same laws; a test compares the two.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from rlco.physics.effects.command import newest_arrival
from rlco.physics.effects.step_forces import set_friction, set_torques
from rlco.physics.mj.compiling import inner
from rlco.physics.mj.copying import copy_into
from rlco.physics.mj.libmujoco import (
    doubles,
    mj_comPos,
    mj_comVel,
    mj_fwdActuation,
    mj_kinematics,
    mj_makeM,
    mj_rne,
)
from rlco.physics.native.world_memory import ACTUATION, APPLIED, BIAS, QPOS, QVEL


@inner
def write_friction(control: Any, memory: Any, e: int) -> None:
    """Write the friction of the next physics step into the world's model."""
    f, nv = memory.fields[e], control.nv
    set_friction(
        control.acting.forces.friction,
        doubles(f[QPOS], control.nq),
        doubles(f[QVEL], nv),
        doubles(f[ACTUATION], nv),
        doubles(f[APPLIED], nv),
        doubles(f[BIAS], nv),
        memory.coulomb[e],
        doubles(memory.friction[e], nv),
    )


@inner
def write_torques(control: Any, memory: Any, e: int) -> None:
    """Write the torques that depend on the actuators' forces in this step."""
    f, nv = memory.fields[e], control.nv
    mj_fwdActuation(memory.models[e], f[0])
    set_torques(
        control.acting.forces.torque,
        doubles(f[QPOS], control.nq),
        doubles(f[QVEL], nv),
        doubles(f[ACTUATION], nv),
        doubles(f[BIAS], nv),
        doubles(f[APPLIED], nv),
    )


@inner
def observe(control: Any, memory: Any, e: int) -> None:
    """Compute the robot's state as observed by its controller.

    Positions and velocities are those that the encoders report. Kinematics, inertia and
    bias forces follow from the model without effects.
    """
    acting, f, observed = control.acting, memory.fields[e], memory.observed[e]
    qpos, reported = doubles(f[QPOS], control.nq), doubles(observed[QPOS], control.nq)
    for i in range(control.nq):
        reported[i] = acting.reported[0, i] * qpos[i] + acting.reported[1, i]
    qvel, speed = doubles(f[QVEL], control.nv), doubles(observed[QVEL], control.nv)
    for d in range(control.nv):
        speed[d] = acting.reported_speed[d] * qvel[d]
    mj_kinematics(acting.controller_model, observed[0])
    mj_comPos(acting.controller_model, observed[0])
    mj_makeM(acting.controller_model, observed[0])
    mj_comVel(acting.controller_model, observed[0])
    mj_rne(acting.controller_model, observed[0], 0, observed[BIAS])


@njit(nogil=True, cache=True)
def observe_range(which: Any, control: Any, memory: Any) -> None:
    """Compute the states of the worlds `which` as observed by their controllers."""
    if control.acting.controller_model:
        for row in range(which.shape[0]):
            observe(control, memory, which[row])


@inner
def send(control: Any, memory: Any, e: int, given: Any) -> None:
    """Store a command that arrives late by a random time.

    Row i of the world's pending commands has the number `passed` + 1 + i. Before the
    episode's first command the world was sent zeros, as with a fixed delay.
    """
    clock = memory.clock[e]
    if clock == 0:
        memory.passed[e] = -control.acting.room
    number = clock // control.substeps
    memory.pending[e, number - memory.passed[e] - 1] = given


@inner
def _arrives(control: Any, memory: Any, e: int) -> bool:
    """Return whether a command arrives that was late by a random time."""
    acting, clock, pending = control.acting, memory.clock[e], memory.pending[e]
    before = memory.passed[e]
    passed, arrived = newest_arrival(
        acting.random,
        memory.seed[e],
        acting.whole * control.substeps + acting.phase,
        acting.period,
        control.substeps,
        clock,
        before,
        clock // control.substeps,
    )
    if arrived > before:
        copy_into(memory.action[e], 0, pending[arrived - before - 1])
    gone = passed - before
    if gone > 0:
        for i in range(pending.shape[0] - gone):
            copy_into(pending[i], 0, pending[i + gone])
        memory.passed[e] = passed
    return bool(arrived > before)


@inner
def goal_is_due(control: Any, memory: Any, e: int, step: int, action: Any) -> bool:
    """Return whether the controller reads a new command in this physics step.

    Args:
        control: The controller.
        memory: Of all worlds.
        e: The world.
        step: Physics step of the control step.
        action: The command that arrives in this control step.
    """
    acting, clock = control.acting, memory.clock[e]
    if acting.random.shape[0]:
        return _arrives(control, memory, e) or bool(clock == 0)
    if step == acting.phase:
        memory.action[e] = action
        memory.unread[e] = True
    due = bool(memory.unread[e])
    if acting.period > 0.0:
        # Periods are counted from here, because commands are read before they travel.
        since = clock - acting.whole * control.substeps - acting.phase
        now = np.floor(since / acting.period + 1e-9)
        due = due and bool(now > np.floor((since - 1) / acting.period + 1e-9))
    # A robot holds its position until the first command arrives.
    due = due or bool(clock == 0)
    memory.unread[e] = memory.unread[e] and not due
    return due


@njit(nogil=True, cache=True)
def lag_behind(control: Any, memory: Any, e: int, ctrl: Any) -> None:
    """Move lagging actuators a fraction of the distance to their commands."""
    lag, reached = control.acting.lag, memory.ctrl[e]
    for a in range(control.nu):
        if lag[a] < 1.0 and memory.clock[e] > 0:
            reached[a] += lag[a] * (ctrl[a] - reached[a])
            ctrl[a] = reached[a]
        else:
            reached[a] = ctrl[a]
