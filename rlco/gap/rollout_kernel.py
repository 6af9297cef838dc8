"""One open-loop rollout of a commanded robot, compiled, without the GIL."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from rlco.physics.libmujoco import mj_step


@njit(cache=True, nogil=True)
def roll_out(
    model: int, data: int, views: Any, commands: Any, read: Any, track: Any
) -> None:
    """Step a model through its commands, and write down positions before each step.

    Args:
        model: Address of the ``mjModel``.
        data: Address of its ``mjData``, set to the initial state.
        views: Arrays of the ``mjData``: qpos (nq,) and ctrl (nu,).
        commands: One row a physics step, (steps, nu).
        read: Columns and addresses, ``track[:, read[i, 0]] += qpos[read[i, 1]]``.
        track: Written: positions, (steps + 1, columns), zeros at first.
    """
    qpos, ctrl = views
    for step in range(len(commands) + 1):
        for row in range(len(read)):
            track[step, read[row, 0]] += qpos[read[row, 1]]
        if step < len(commands):
            ctrl[:] = commands[step]
            mj_step(model, data)


@njit(cache=True, nogil=True)
def roll_out_terms(
    model: int,
    data: int,
    views: Any,
    commands: Any,
    read: Any,
    track: Any,
    forces: Any,
    terms: Any,
    drives: Any,
) -> None:
    """As `roll_out`, with friction and drive losses that change at each step.

    Friction comes from the forces at the end of the step before, as on top of any
    engine (BAM, arXiv 2410.08650); what a drive loses from what it is asked for now.

    Args:
        model: Address of the ``mjModel``; its ``dof_frictionloss`` is written.
        data: As in `roll_out`.
        views: As in `roll_out`.
        commands: As in `roll_out`.
        read: As in `roll_out`.
        track: As in `roll_out`.
        forces: Arrays: the model's dof_frictionloss and the data's qvel, qfrc_bias,
            qfrc_actuator and qfrc_applied, (nv,) each.
        terms: Arrays: static, stribeck_speed and load (nv,), drive (nu,), and the
            friction of the model itself (nv,).
        drives: Arrays: the degree of freedom that each actuator drives, -1 for none,
            the address of its position (nu,), its gear (nu,), and its force a unit of
            command, at zero, a unit of length, a unit of velocity, and its least and
            largest force, (nu, 6).
    """
    qpos, ctrl = views
    friction, qvel, bias, actuation, applied = forces
    dofs, places, gears, laws = drives
    static, speed, load, drive, coulomb = terms
    for step in range(len(commands) + 1):
        for row in range(len(read)):
            track[step, read[row, 0]] += qpos[read[row, 1]]
        if step == len(commands):
            break
        for dof in range(len(friction)):
            stribeck = static[dof] * np.exp(-((qvel[dof] / speed[dof]) ** 2))
            carried = abs(actuation[dof] + applied[dof] + bias[dof])
            friction[dof] = coulomb[dof] + stribeck + load[dof] * carried
            applied[dof] = 0.0
        for actuator in range(len(drive)):
            dof = dofs[actuator]
            if drive[actuator] > 0.0 and dof >= 0:
                gear, law = gears[actuator], laws[actuator]
                force = law[0] * commands[step, actuator] + law[1]
                force += gear * (law[2] * qpos[places[actuator]] + law[3] * qvel[dof])
                torque = gear * min(max(force, law[4]), law[5])
                kept = 1.0 / (1.0 + drive[actuator] * abs(torque))
                applied[dof] -= (1.0 - kept) * torque
        ctrl[:] = commands[step]
        mj_step(model, data)
