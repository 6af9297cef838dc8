"""Step a model through its commands, with forces that MJCF cannot express."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.compare.arm.kernel import Outside, Views, roll_out, roll_out_forces
from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array
from rlco.physics.effects.step_forces import StepForces

NONE = Outside(-1, -1, np.zeros(0), np.zeros((0, 2)), (0.0, 0.0))


def step_through(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    commands: Array,
    read: Integers,
    track: Array,
    forces: StepForces,
    outside: Outside | None = None,
) -> None:
    """Step a model through its commands, from the current state of its data.

    Args:
        model: The model; restored when this returns.
        data: Its state; holds the final state when this returns.
        commands: One row per physics step, (steps, nu).
        read: Columns and addresses to record, see `roll_out`.
        track: Output: positions before each step, (steps + 1, columns).
        forces: Forces at each step beyond the model's own.
        outside: A torque from outside; None: there is none.
    """
    addresses = (model._address, data._address)
    commands = np.ascontiguousarray(commands)
    if outside is None and not (forces.friction.rows.size or forces.torque.rows.size):
        roll_out(*addresses, (data.qpos, data.ctrl), commands, read, track)
        return
    own = model.dof_frictionloss.copy()
    views = Views(
        data.qpos,
        data.qvel,
        data.ctrl,
        data.qfrc_bias,
        data.qfrc_actuator,
        data.qfrc_applied,
        model.dof_frictionloss,
        own,
    )
    runge_kutta = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    mujoco.mj_forward(model, data)
    inputs = (commands, read, track, forces, outside or NONE)
    roll_out_forces(*addresses, views, *inputs, bool(runge_kutta))
    model.dof_frictionloss[:] = own
