"""Chatter: servos too stiff for the time step, bounded only by a force limit.

Without limits such a simulation diverges. With them it swings to and fro at each step,
with amplitudes that are finite but meaningless.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.compare.arm.divergence import (
    PARTS,
    at_start,
    is_implicit,
    with_finer_step,
)
from rlco.gap.compare.arm.kernel import roll_out
from rlco.gap.compare.problem import Divergence, Hypothesis, Problem, Run
from rlco.gap.compare.stability.servo_stability import joint_servo
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import servo_joints
from rlco.physics.mj.libmujoco import silenced_warnings

_FINER = 8  # divisor of the time step in the reference simulation
_MARGIN = 1.4  # of an advised time step below the largest stable one
_FLOORS = 10.0  # difference between the two, in noise floors, that counts as chatter


@dataclass(frozen=True)
class Chatter:
    """Joints that chatter in rollouts.

    Attributes:
        runs: The rollouts, one for each recording that has such joints.
        divergences: Where and when in each.
        timestep: The largest time step tried at which all their servos are stable [s],
            None for none.
        implicit: Whether they are stable at the model's own time step with the
            integrator ``implicitfast``.
    """

    runs: tuple[Run, ...]
    divergences: tuple[Divergence, ...]
    timestep: float | None
    implicit: bool


def find_chatter(problem: Problem) -> Chatter | None:
    """Return the joints that chatter, or None if there are none.

    A joint chatters if its servo is unstable at the time step by its gains and inertia,
    and its simulated motion differs at a finer time step. The second condition excludes
    a servo that is too stiff but held by friction or a stop.
    """
    first = problem.runs(Hypothesis(), [0])
    joints = _unstable(problem, first[0].model, first[0].qpos) if first else []
    runs, divergences = [], []
    for recording in range(len(problem.log.recordings)) if joints else ():
        for run in problem.runs(Hypothesis(), [recording]):
            divergence = _first(problem, run, joints)
            if divergence is not None:
                runs.append(run)
                divergences.append(divergence)
                break
    if not runs:
        return None
    slower = [parts for parts in PARTS if not _unstable_at(problem, runs[0], parts)]
    step = float(runs[0].model.opt.timestep)
    return Chatter(
        tuple(runs),
        tuple(divergences),
        step / slower[0] if slower else None,
        not is_implicit(runs[0].model)
        and not _unstable_at(problem, runs[0], 1, implicit=True),
    )


def _unstable_at(
    problem: Problem, run: Run, parts: int, *, implicit: bool = False
) -> bool:
    model = with_finer_step(run, parts=parts, implicit=implicit)
    return bool(_unstable(problem, model, run.qpos, _MARGIN))


def _unstable(
    problem: Problem, model: mujoco.MjModel, qpos: Array, margin: float = 1.0
) -> list[str]:
    """Return the logged joints whose servo is unstable at the model's time step."""
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        return []
    step = margin * float(model.opt.timestep)
    driven = set(servo_joints(model)) & set(problem.log.joints)
    return [
        name
        for name in problem.log.joints
        if name in driven and joint_servo(model, qpos, name).critical < step
    ]


def _first(problem: Problem, run: Run, joints: list[str]) -> Divergence | None:
    model = run.model
    for joint in joints:
        apart = np.abs(_track(run, joint, 1) - _track(run, joint, _FINER))
        noise = float(problem.noise[problem.layout.channels.index(joint)])
        if np.sqrt(np.mean(apart**2)) <= _FLOORS * noise:
            continue
        when = int(np.argmax(~(apart < _FLOORS * noise)))
        body = int(model.jnt_bodyid[model.joint(joint).id])
        return Divergence(
            run.recording,
            problem.log.recordings[run.recording].name,
            run.time + when * float(model.opt.timestep),
            joint,
            str(model.body(body).name) or None,
        )
    return None


def _track(run: Run, joint: str, parts: int) -> Array:
    """Return a joint's positions at each of the finer steps, (steps + 1,)."""
    model = with_finer_step(run, parts=parts)
    data = at_start(model, run)
    commands = np.repeat(run.commands, parts, axis=0)
    read = np.array([[0, int(model.joint(joint).qposadr[0])]])
    track = np.zeros((len(commands) + 1, 1))
    views = (data.qpos, data.ctrl)
    with silenced_warnings():
        roll_out(model._address, data._address, views, commands, read, track)
    positions: Array = track[::parts, 0]
    return positions
