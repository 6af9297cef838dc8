"""Build the comparison of a robosuite task with a log of its actions."""

from __future__ import annotations

from dataclasses import replace

from rlco.gap.demos.conventions.check import check_conventions
from rlco.gap.demos.replay.plants import Plants
from rlco.gap.demos.replay.rollouts import Rollouts
from rlco.gap.demos.replay.task_space import TaskSpaceProblem, task_at_rate
from rlco.gap.logs.log import Log
from rlco.physics.spec.domain import GivenDomain, make_domain
from rlco.physics.spec.names import ACTION_NAMES
from rlco.physics.spec.task import Task
from rlco.physics.tasks.make_task import make_task


def holds_actions(log: Log) -> bool:
    """Return whether a log holds a task's own actions."""
    command = log.recordings[0].command if log.recordings else None
    return command is not None and command.shape[1:] == (len(ACTION_NAMES),)


def make_task_problem(
    task: str | Task, log: Log, *, domain: GivenDomain = "sim", threads: int = 2
) -> TaskSpaceProblem:
    """Compare a log with a task, after matching its conventions.

    Differences found by `rlco.gap.demos.conventions` are corrected in the log and
    noted.

    Args:
        task: The task or its name.
        log: Recordings of its actions.
        domain: The simulator.
        threads: Simulations that run in parallel.

    Raises:
        DataError: If the log cannot belong to this task.
    """
    task = task_at_rate(make_task(task), log)
    rollouts = Rollouts(Plants(task, make_domain(domain)), threads)
    conventions = check_conventions(task, log, domain=domain, rollouts=rollouts)
    corrected = conventions.apply(log)
    notes = tuple(note for note in corrected.notes if "conventions: " not in note)
    corrected = replace(corrected, notes=(*notes, conventions.summary))
    return TaskSpaceProblem(task, corrected, domain=domain, rollouts=rollouts)
