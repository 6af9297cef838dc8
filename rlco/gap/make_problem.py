"""Choose the comparison that fits a log: from a robot and recordings to a problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rlco.errors import DataError, counted
from rlco.files import few
from rlco.gap.compare.arm.commands.missing import with_missing_commands
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.comparisons import Compared
from rlco.gap.compare.noise import position_noise
from rlco.gap.compare.problem import Hypothesis, Problem
from rlco.gap.compare.servo.bench import ServoBench
from rlco.gap.logs.log import Array, Log, Recording
from rlco.gap.logs.names import match_names
from rlco.gap.model import LoadedModel, load_servo
from rlco.gap.servo_models import PREFIX, SERVOS, Servo
from rlco.physics.effects.targets import servo_joints
from rlco.physics.mj.libmujoco import silenced_warnings
from rlco.physics.spec.names import ACTION_NAMES, TASK_NAMES

FEWEST = 6  # recordings, or parts of them, for fitting and holding out
SEGMENT = 0.4  # length of a rollout for a robot that keeps its initial error [s]
GROWTH = 2.0  # growth of an initial error that marks such a robot
SHORTEST = 1.0  # shortest part of a recording [s]
EARLIER = 1.0  # commands before a part that may still act on it [s]


def make_problem(
    loaded: LoadedModel,
    log: Log,
    *,
    threads: int = 2,
    compare: Compared | None = None,
    cut: bool = True,
) -> Problem:
    """Return the comparison of this log with simulation.

    Args:
        loaded: The robot's model.
        log: Its recordings.
        threads: Rollouts that run in parallel.
        compare: ``torques`` for these where the log has commands, too; None for what
            it has, commands before torques.
        cut: Whether a few recordings are cut into parts, some of which a search then
            holds out.

    Raises:
        DataError: If the log holds nothing that can be compared.
    """
    if loaded.servo is not None:
        return _on_bench(loaded.servo, log)
    _refuse_gains(loaded, log)
    log = _with_hint(log)
    first = log.recordings[0]
    task = loaded.task if loaded.task in TASK_NAMES else None
    unknown = [name for name in log.actuators if name not in loaded.actuators]
    if task:
        # robosuite, which a model of one's own need not wait for.
        from rlco.gap.demos.task_problem import holds_actions, make_task_problem

        if holds_actions(log) and not _name_joints(log, loaded):
            return make_task_problem(task, log, threads=threads)
    if first.pose is not None:
        from rlco.gap.compare.free_body import FreeBody

        return FreeBody(loaded.spec, log, threads=threads)
    if first.command is not None and unknown:
        raise DataError(_other_actions(log, loaded, ACTION_NAMES if task else ()))
    parts = in_parts(log) if cut else log
    sent = first.command is not None and first.position is not None and log.actuators
    if sent and compare != "torques":
        return _commanded(loaded, parts, threads)
    if first.torque is not None and first.position is not None:
        from rlco.gap.compare.torque.convention import torque_problem

        return torque_problem(loaded.spec, parts)
    raise DataError(
        "the log holds neither commands and positions, nor torques and positions, nor "
        "a free body's pose: record one of these."
    )


def as_compared(loaded: LoadedModel, problem: Problem) -> LoadedModel:
    """Return the model that a problem compares: a servo with the log's pendulum."""
    if not isinstance(problem, ServoBench):
        return loaded
    return load_servo(problem.servo, problem.pendulums[0])


def _on_bench(servo: Servo, log: Log) -> ServoBench:
    """Return a servo on its bench.

    Raises:
        DataError: If the log is of another servo, or not of a bench.
    """
    devices = {recording.device for recording in log.recordings} - {"", servo.name}
    if devices:
        raise DataError(
            f"the log is of {few(sorted(devices))} and model={PREFIX}{servo.name} is "
            f"another servo; give the log's own as model={PREFIX}NAME (known: "
            f"{', '.join(SERVOS)}), or recordings of {servo.name}."
        )
    return ServoBench(servo, log)


def _refuse_gains(loaded: LoadedModel, log: Log) -> None:
    """Raise where recordings of several gains are for a model that has one stiffness.

    Raises:
        DataError: Says which gains.
    """
    gains = sorted({r.facts["kp"] for r in log.recordings if "kp" in r.facts})
    if len(gains) < 2:
        return
    device = log.recordings[0].device
    servo = PREFIX + (device if device in SERVOS else "SERVO")
    raise DataError(
        f"the log is of a servo under {len(gains)} gains of its firmware, kp "
        f"{few([f'{gain:g}' for gain in gains])}, and model {loaded.name!r} has one "
        f"stiffness; give model={servo} (known: {', '.join(SERVOS)}), which has the "
        "firmware, or recordings of one gain."
    )


def _with_hint(log: Log) -> Log:
    """Return a log that says so where its servo is known, and its model is another."""
    device = log.recordings[0].device
    if device not in SERVOS:
        return log
    hint = (
        f"These are recordings of {device} on a bench: model={PREFIX}{device} compares "
        "them with its firmware and its drive, which the model given does not have."
    )
    return replace(log, notes=(*log.notes, hint))


def compared_in(problem: Problem) -> Compared:
    """Return what a problem compares."""
    from rlco.gap.compare.torque.torque_log import TorqueLog
    from rlco.gap.demos.replay.task_space import TaskSpaceProblem

    if isinstance(problem, TorqueLog):
        return "torques"
    if isinstance(problem, TaskSpaceProblem):
        return "task"
    return "positions" if problem.log.body is None else "poses"


def _name_joints(log: Log, loaded: LoadedModel) -> bool:
    found = match_names(log.actuators, loaded.joints)
    return bool(log.actuators) and len(found) == len(log.actuators)


def _other_actions(log: Log, loaded: LoadedModel, own: Sequence[str]) -> str:
    """Return a message that a log's actions match no inputs of this model."""
    joints = "commands of joints, " if _name_joints(log, loaded) else ""
    logged = f"the log's {counted(len(log.actuators), 'action')}"
    are = "is" if len(log.actuators) == 1 else "are"
    sent = f"{logged} ({few(log.actuators)}) {are} {joints}"
    theirs = f"{counted(len(loaded.actuators), 'actuator')} "
    theirs += f"({few(loaded.actuators, 3) or 'none'})"
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
    log = with_missing_commands(loaded.spec, log, noise, SEGMENT, threads)
    whole_recordings = ArmRollouts(loaded.spec, log, noise, threads=threads)
    if forgets(whole_recordings) or _diverges(whole_recordings):
        return whole_recordings
    return ArmRollouts(loaded.spec, log, noise, horizon=SEGMENT, threads=threads)


def _diverges(problem: ArmRollouts) -> bool:
    """Return whether a robot with servos diverges, which is then the model's fault.

    Without feedback, a rollout may also diverge under a correct model.
    """
    if not set(problem.log.joints) <= set(servo_joints(problem.model)):
        return False
    return not np.isfinite(problem.residuals([Hypothesis()])).all()


def forgets(problem: ArmRollouts) -> bool:
    """Return whether rollouts converge from slightly different initial states."""
    slight = 10.0 * problem.noise
    first = [segment for segment in problem.segments if segment.recording == 0][:1]
    moved = replace(first[0], state=first[0].state + np.stack([slight, 0.0 * slight]))
    with silenced_warnings():
        rows = [
            problem.simulate(Hypothesis(), [segment]) for segment in (first[0], moved)
        ]
    if not np.isfinite(rows).all():
        return False
    apart = np.abs(rows[1] - rows[0]).reshape(-1, len(slight)) / slight
    later = apart[len(apart) // 4 :]
    return bool(apart.max() < 3.0 * GROWTH and later.max() < GROWTH)


def in_parts(log: Log) -> Log:
    """Return a log with enough parts to hold some of them out.

    Long recordings are cut, and each part starts from its own measured state.
    """
    count = len(log.recordings)
    if count >= FEWEST:
        return log
    pieces = -(-FEWEST // count)
    parts = [part for one in log.recordings for part in _cut(one, pieces)]
    if len(parts) == count:
        return log
    note = (
        f"{'The recording was' if count == 1 else f'The {count} recordings were'} cut "
        f"into {len(parts)} parts, some to be fitted and some held out, each from its "
        f"own measured state; {FEWEST} or more recordings are taken as they are."
    )
    return replace(log, recordings=tuple(parts), notes=(*log.notes, note))


def _cut(recording: Recording, pieces: int) -> list[Recording]:
    pieces = max(1, min(pieces, int(recording.seconds / SHORTEST)))
    bounds = np.linspace(0, recording.rows, pieces + 1).astype(int)
    if pieces == 1:
        return [recording]
    return [
        replace(
            recording.take(slice(bounds[i], bounds[i + 1])),
            name=f"{recording.name}, part {i + 1}",
            cut_from=recording.name,
            unread=_unread(recording, bounds[i], bounds[i + 1]),
        )
        for i in range(pieces)
    ]


def _unread(recording: Recording, row: int, end: int) -> tuple[Array, Array] | None:
    """Return times and commands beside a part's rows, None where there are none."""
    if recording.command is None:
        return None
    since = recording.time[row] - EARLIER
    rows = slice(int(np.searchsorted(recording.time, since)), row)
    time, sent = recording.time[rows], recording.command[rows]
    if recording.unread is not None:
        own, lost = recording.unread
        near = (own >= since) & (own < recording.time[end - 1])
        time, sent = np.r_[time, own[near]], np.concatenate([sent, lost[near]])
        order = np.argsort(time, kind="stable")
        time, sent = time[order], sent[order]
    return (time, sent) if len(time) else None
