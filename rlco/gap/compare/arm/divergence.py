"""Find where and when a rollout diverges, and a time step at which it does not."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from rlco.gap.compare.arm.kernel import roll_out
from rlco.gap.compare.problem import Divergence, Run
from rlco.gap.logs.log import Log
from rlco.physics.mj.libmujoco import silenced_warnings

_WARNINGS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
_IMPLICIT = (
    mujoco.mjtIntegrator.mjINT_IMPLICIT,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
)
PARTS = (2, 4, 8, 16, 32, 64)  # divisors of the model's time step to try
_CHUNK = 256  # steps between two checks for divergence
_FAST = 30.0  # speed that a robot's joint hardly ever reaches [rad/s or m/s]
_TRIED = 8  # runs that a smaller time step has to keep stable


def diverged(data: mujoco.MjData) -> bool:
    """Return whether MuJoCo warned of a state that is not finite or far too large.

    MuJoCo then resets the state, unless the model disables that: values read afterwards
    are finite but meaningless.
    """
    return any(data.warning[which].number for which in _WARNINGS)


def first_divergence(run: Run, log: Log) -> Divergence | None:
    """Step a rollout again and return where it diverges, or None if it does not."""
    data, model = at_start(run.model, run), run.model
    touching = np.zeros((0, 2), dtype=np.int32)
    ordinary, fastest = _FAST + 3.0 * np.abs(run.qvel), -1
    for step, command in enumerate(run.commands):
        # Later, other joints are shaken as fast or faster.
        speed = np.abs(data.qvel)
        if fastest < 0 and (speed > ordinary).any():
            fastest = int(np.argmax(speed / ordinary))
        data.ctrl[:] = command
        mujoco.mj_step(model, data)
        if diverged(data):
            first = fastest if fastest >= 0 else int(speed.argmax())
            joint = int(model.dof_jntid[first])
            return Divergence(
                run.recording,
                log.recordings[run.recording].name,
                run.time + step * float(model.opt.timestep),
                str(model.joint(joint).name) or None,
                str(model.body(int(model.jnt_bodyid[joint])).name) or None,
                _bodies(model, touching),
            )
        if data.ncon:
            touching = data.contact.geom.copy()
    return None


def stable_timestep(runs: Sequence[Run]) -> float | None:
    """Return the largest time step tried at which no rollout diverges [s].

    The model's time step is divided by 2, 4 and so on up to 64. None if the rollouts
    diverge at all of these.
    """
    for parts in PARTS:
        if all(_is_stable(run, parts=parts) for run in runs[:_TRIED]):
            return float(runs[0].model.opt.timestep) / parts
    return None


def is_stable_implicitly(runs: Sequence[Run]) -> bool:
    """Return whether the rollouts stay stable with the integrator ``implicitfast``."""
    if is_implicit(runs[0].model):
        return False
    return all(_is_stable(run, implicit=True) for run in runs[:_TRIED])


def is_implicit(model: mujoco.MjModel) -> bool:
    """Return whether a model's integrator treats damping forces implicitly."""
    return bool(model.opt.integrator in _IMPLICIT)


def with_finer_step(
    run: Run, *, parts: int = 1, implicit: bool = False
) -> mujoco.MjModel:
    """Return a rollout's model with its time step divided by `parts`."""
    model = copy.copy(run.model)
    model.opt.timestep /= parts
    if implicit:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def at_start(model: mujoco.MjModel, run: Run) -> mujoco.MjData:
    """Return the initial state of a rollout."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = run.qpos, run.qvel
    return data


def _is_stable(run: Run, *, parts: int = 1, implicit: bool = False) -> bool:
    model = with_finer_step(run, parts=parts, implicit=implicit)
    data, nothing = at_start(model, run), np.zeros((0, 2), dtype=np.int64)
    track = np.zeros((_CHUNK * parts + 1, 1))
    addresses, views = (model._address, data._address), (data.qpos, data.ctrl)
    with silenced_warnings():
        for first in range(0, len(run.commands), _CHUNK):
            some = np.repeat(run.commands[first : first + _CHUNK], parts, axis=0)
            roll_out(*addresses, views, some, nothing, track[: len(some) + 1])
            if diverged(data):
                return False
    return bool(np.isfinite(data.qpos).all())


def _bodies(
    model: mujoco.MjModel, geoms: np.ndarray[tuple[int, int], np.dtype[np.int32]]
) -> tuple[tuple[str, str], ...]:
    pairs = model.geom_bodyid[geoms]
    named = [(str(model.body(a).name), str(model.body(b).name)) for a, b in pairs]
    return tuple(dict.fromkeys(named))
