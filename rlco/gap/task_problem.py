"""From a robosuite task and a log of its actions to a comparison."""

from __future__ import annotations

from dataclasses import replace

from rlco.gap.conventions import check_conventions
from rlco.gap.log import Log
from rlco.gap.task_plants import Plants
from rlco.gap.task_rollouts import Rollouts
from rlco.gap.task_space import TaskSpaceProblem, task_at_rate
from rlco.physics.domain import Domain, make_domain
from rlco.physics.observation import ACTION_NAMES
from rlco.physics.task import Task, make_task


def holds_actions(log: Log) -> bool:
    """Return whether a log holds a task's own actions."""
    command = log.recordings[0].command if log.recordings else None
    return command is not None and command.shape[1:] == (len(ACTION_NAMES),)


def make_task_problem(
    task: str | Task, log: Log, *, domain: str | Domain = "sim", threads: int = 2
) -> TaskSpaceProblem:
    """Compare a log with a task, once their conventions agree.

    What `rlco.gap.conventions` finds is mended in the log, and said in its notes.

    Args:
        task: The task or its name.
        log: Recordings of its actions.
        domain: The simulator.
        threads: Simulations at a time.

    Raises:
        DataError: If the log cannot be of this task.
    """
    task = task_at_rate(make_task(task), log)
    rollouts = Rollouts(Plants(task, make_domain(domain)), threads)
    conventions = check_conventions(task, log, domain=domain, rollouts=rollouts)
    mended = conventions.apply(log)
    notes = tuple(note for note in mended.notes if "conventions: " not in note)
    mended = replace(mended, notes=(*notes, conventions.summary))
    return TaskSpaceProblem(task, mended, domain=domain, rollouts=rollouts)
