"""One open-loop rollout of a commanded robot, compiled, without the GIL."""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import njit

from rlco.gap.logs.log import Array
from rlco.physics.effects.step_forces import set_friction, set_torques
from rlco.physics.mj.copying import copy_into
from rlco.physics.mj.libmujoco import mj_fwdActuation, mj_step, mj_step1, mj_step2


@njit(cache=True, nogil=True)
def roll_out(
    model: int, data: int, views: Any, commands: Any, read: Any, track: Any
) -> None:
    """Step a model through its commands and record positions before each step.

    Args:
        model: Address of the ``mjModel``.
        data: Address of its ``mjData``, set to the initial state.
        views: Arrays of the ``mjData``: qpos (nq,) and ctrl (nu,).
        commands: One row per physics step, (steps, nu).
        read: Columns and addresses, ``track[:, read[i, 0]] += qpos[read[i, 1]]``.
        track: Output: positions, (steps + 1, columns), initially zero.
    """
    qpos, ctrl = views
    for step in range(len(commands) + 1):
        for row in range(len(read)):
            track[step, read[row, 0]] += qpos[read[row, 1]]
        if step < len(commands):
            copy_into(ctrl, 0, commands[step])
            mj_step(model, data)


class Views(NamedTuple):
    """MuJoCo arrays that a rollout with additional forces reads and writes."""

    qpos: Array  # (nq,)
    qvel: Array  # (nv,)
    ctrl: Array  # (nu,)
    bias: Array  # (nv,)
    actuation: Array  # (nv,)
    applied: Array  # output, (nv,)
    friction: Array  # the model's ``dof_frictionloss``, overwritten, (nv,)
    own: Array  # its values without friction from effects, (nv,)


class Outside(NamedTuple):
    """A torque that acts on one joint from outside, and no effect describes."""

    dof: int  # its degree of freedom; -1: there is none
    address: int  # of its position
    torque: Array  # at each step (steps,) [N m or N]; an output with a path
    path: Array  # position and velocity that it makes the joint follow, (steps, 2)
    gains: tuple[float, float]  # on the distance to these


@njit(cache=True, nogil=True)
def roll_out_forces(
    model: int,
    data: int,
    views: Views,
    commands: Any,
    read: Any,
    track: Any,
    forces: Any,
    outside: Outside,
    runge_kutta: bool,
) -> None:
    """Do the same as `roll_out`, with forces from effects at each step.

    Args:
        model: Address of the ``mjModel``; its ``dof_frictionloss`` is written.
        data: As in `roll_out`.
        views: Arrays of both.
        commands: As in `roll_out`.
        read: As in `roll_out`.
        track: As in `roll_out`.
        forces: A `StepForces`.
        outside: A torque from outside.
        runge_kutta: Whether the model uses the Runge-Kutta integrator, which
            ``mj_step2`` does not support.
    """
    v, dof = views, outside.dof
    for step in range(len(commands) + 1):
        for row in range(len(read)):
            track[step, read[row, 0]] += v.qpos[read[row, 1]]
        if step == len(commands):
            break
        set_friction(
            forces.friction,
            v.qpos,
            v.qvel,
            v.actuation,
            v.applied,
            v.bias,
            v.own,
            v.friction,
        )
        copy_into(v.ctrl, 0, commands[step])
        if dof >= 0:
            v.applied[dof] = 0.0
        if forces.torque.rows.shape[0]:
            mj_step1(model, data)
            mj_fwdActuation(model, data)
            set_torques(forces.torque, v.qpos, v.qvel, v.actuation, v.bias, v.applied)
        if dof >= 0:
            if len(outside.path):
                away = outside.path[step, 0] - v.qpos[outside.address]
                slower = outside.path[step, 1] - v.qvel[dof]
                stiffness, damping = outside.gains
                outside.torque[step] = stiffness * away + damping * slower
            v.applied[dof] += outside.torque[step]
        if forces.torque.rows.shape[0] == 0:
            mj_step(model, data)
            continue
        if runge_kutta:
            mj_step(model, data)
        else:
            mj_step2(model, data)
