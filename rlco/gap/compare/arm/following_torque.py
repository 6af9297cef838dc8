"""The torque from outside that keeps one joint of a rollout on its measured path.

A stiff spring and damper between the joint and what was measured of it make the
rollout follow, and what they pull with is the torque that the model lacks there. So a
knock is found in one rollout, however large: where a motor reached its limit and the
arm fell away, no change of the model's own rollout says by how much.
"""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.compare.arm.kernel import Outside
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.arm.step_through import step_through
from rlco.gap.compare.problem import Hypothesis, Run
from rlco.gap.compare.segments import command_steps, joint_velocity
from rlco.gap.logs.log import Array
from rlco.physics.effects.apply import step_forces, true_positions
from rlco.physics.effects.targets import dof_of
from rlco.physics.mj.libmujoco import silenced_warnings

_RATE = 40.0  # of the spring and the joint's inertia [rad/s]: a time of 25 ms
_PART = 0.4  # of a physics step, and
_ROWS = 0.8  # of a row's time, that this rate is at most the inverse of


def following_torque(
    problem: ArmRollouts, hypothesis: Hypothesis, joint: str
) -> dict[int, Array] | None:
    """Return the torques that keep a joint on its measured path.

    Args:
        problem: The robot and its log.
        hypothesis: What acts already.
        joint: The joint.

    Returns:
        By recording, one at each physics step from the first of its commands, (steps,)
        [N m or N], as `ArmRollouts.with_torques` takes them; None where the rollout
        diverges.
    """
    step = float(problem.model.opt.timestep)
    logs = problem.log.recordings
    times = [command_steps(one, step) for one in logs]
    found: dict[int, Array] = {i: np.zeros(len(one)) for i, one in enumerate(times)}
    with silenced_warnings():
        for run in problem.runs(hypothesis, range(len(logs))):
            begin = int(np.searchsorted(times[run.recording], run.time - 0.5 * step))
            steps = slice(begin, begin + len(run.commands))
            path = _path(problem, hypothesis, joint, run, times[run.recording][steps])
            torque = _followed(problem, hypothesis, joint, run, path)
            if not np.isfinite(torque).all():
                return None
            found[run.recording][steps] = torque
    return found


def _path(
    problem: ArmRollouts, hypothesis: Hypothesis, joint: str, run: Run, times: Array
) -> Array:
    """Return measured position and velocity of a joint at times, (steps, 2)."""
    log, joints = problem.log.recordings[run.recording], problem.log.joints
    measured = np.array(log.position, dtype=float)
    position = true_positions(measured, joints, hypothesis.effects)
    column = joints.index(joint)
    both = position[:, column], joint_velocity(log)[:, column]
    return np.column_stack([np.interp(times, log.time, one) for one in both])


def _followed(
    problem: ArmRollouts, hypothesis: Hypothesis, joint: str, run: Run, path: Array
) -> Array:
    """Return the torque in one rollout, (steps,)."""
    model, data = run.model, mujoco.MjData(run.model)
    data.qpos[:], data.qvel[:] = run.qpos, run.qvel
    mujoco.mj_forward(model, data)
    dof = dof_of(model, joint)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, inertia, data.qM)
    log = problem.log.recordings[run.recording]
    row = float(np.median(np.diff(log.time)))
    rate = min(_RATE, _PART / model.opt.timestep, _ROWS / row)
    gains = inertia[dof, dof] * rate**2, 2.0 * inertia[dof, dof] * rate
    address = int(model.joint(joint).qposadr[0])
    torque = np.zeros(len(run.commands))
    outside = Outside(dof, address, torque, path, gains)
    read = np.array([[0, address]])
    track = np.zeros((len(run.commands) + 1, 1))
    forces = step_forces(model, hypothesis.effects)
    step_through(model, data, run.commands, read, track, forces, outside)
    return torque
