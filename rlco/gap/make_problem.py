"""The comparison that fits a log: how a robot and its recordings become a problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rlco.errors import DataError
from rlco.gap.arm_rollouts import ArmRollouts
from rlco.gap.log import Log, Recording
from rlco.gap.logs.matching import few
from rlco.gap.logs.names import match_names
from rlco.gap.model import LoadedModel
from rlco.gap.noise import position_noise
from rlco.gap.problem import Hypothesis, Problem
from rlco.gap.task_problem import holds_actions, make_task_problem
from rlco.physics.observation import ACTION_NAMES
from rlco.physics.task import TASK_NAMES

FEWEST = 6  # recordings, or parts of them, to fit and to hold out
SHOT = 0.4  # seconds of a rollout of a robot that does not forget where it started
GROWTH = 2.0  # by which an error may grow in a robot that does
SHORTEST = 1.0  # seconds of a part of a recording


def make_problem(loaded: LoadedModel, log: Log, *, threads: int = 2) -> Problem:
    """Return how this log is compared with simulation.

    Args:
        loaded: The robot's model.
        log: Its recordings.
        threads: Rollouts at a time.

    Raises:
        DataError: If the log holds nothing that can be compared.
    """
    first = log.recordings[0]
    task = loaded.task if loaded.task in TASK_NAMES else None
    unknown = [name for name in log.actuators if name not in loaded.actuators]
    if task and holds_actions(log) and not _name_joints(log, loaded):
        return make_task_problem(task, log, threads=threads)
    if first.pose is not None:
        from rlco.gap.free_body import FreeBody

        return FreeBody(loaded.spec, log, threads=threads)
    if first.command is not None and unknown:
        raise DataError(_other_actions(log, loaded, ACTION_NAMES if task else ()))
    if first.command is not None and first.position is not None and log.actuators:
        return _commanded(loaded, in_parts(log), threads)
    if first.torque is not None and first.position is not None:
        from rlco.gap.torque_log import TorqueLog

        return TorqueLog(loaded.spec, in_parts(log))
    raise DataError(
        "the log holds neither commands and positions, nor torques and positions, nor "
        "a free body's pose: record one of these."
    )


def _name_joints(log: Log, loaded: LoadedModel) -> bool:
    found = match_names(log.actuators, loaded.joints)
    return bool(log.actuators) and len(found) == len(log.actuators)


def _other_actions(log: Log, loaded: LoadedModel, own: Sequence[str]) -> str:
    """Say that a log's actions are nothing that this model can be sent."""
    joints = "commands of joints, " if _name_joints(log, loaded) else ""
    sent = f"the log's {len(log.actuators)} actions ({few(log.actuators)}) are {joints}"
    theirs = f"{len(loaded.actuators)} actuators ({few(loaded.actuators, 3) or 'none'})"
    if not own:
        return (
            f"{sent}not those of model {loaded.name!r}, which has {theirs}; give, as "
            "model=, an MJCF file with a position servo for each of them."
        )
    return (
        f"{sent}neither the {len(own)} actions of task {loaded.task!r} ({few(own)}) "
        f"nor those of its model's {theirs}; give a log of the task's actions, or, as "
        "model=, an MJCF file with a position servo for each of the log's."
    )


def _commanded(loaded: LoadedModel, log: Log, threads: int) -> Problem:
    noise = np.asarray(position_noise(log).deviation)
    whole = ArmRollouts(loaded.spec, log, noise, threads=threads)
    if forgets(whole):
        return whole
    return ArmRollouts(loaded.spec, log, noise, horizon=SHOT, threads=threads)


def forgets(problem: ArmRollouts) -> bool:
    """Return whether a rollout ends in the same place from a slightly wrong start."""
    slight = 10.0 * problem.noise
    first = [shot for shot in problem.shots if shot.recording == 0][:1]
    moved = replace(first[0], state=first[0].state + np.stack([slight, 0.0 * slight]))
    rows = [problem.simulate(Hypothesis(), [shot]) for shot in (first[0], moved)]
    if not np.isfinite(rows).all():
        return False
    apart = np.abs(rows[1] - rows[0]).reshape(-1, len(slight)) / slight
    late = apart[len(apart) // 4 :]
    return bool(apart.max() < 3.0 * GROWTH and late.max() < GROWTH)


def in_parts(log: Log) -> Log:
    """Return a log with enough parts, so that some can be held out.

    Long recordings are cut, each part to start from what was measured there.
    """
    if len(log.recordings) >= FEWEST:
        return log
    pieces = -(-FEWEST // len(log.recordings))
    parts = [part for one in log.recordings for part in _cut(one, pieces)]
    return replace(log, recordings=tuple(parts))


def _cut(recording: Recording, pieces: int) -> list[Recording]:
    pieces = max(1, min(pieces, int(recording.seconds / SHORTEST)))
    bounds = np.linspace(0, recording.rows, pieces + 1).astype(int)
    if pieces == 1:
        return [recording]
    return [
        replace(
            recording.take(slice(bounds[i], bounds[i + 1])),
            name=f"{recording.name}, part {i + 1}",
        )
        for i in range(pieces)
    ]
