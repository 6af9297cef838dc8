"""A task by its name: rlco's own, or one in a user's module."""

from __future__ import annotations

import importlib

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.spec.own import of_module
from rlco.physics.spec.task import Task
from rlco.physics.tasks.check_task import check_task


def make_task(task: str | Task) -> Task:
    """Return the task of that name; a `Task` is returned as it is.

    A name is one of rlco's own, or ``module:NAME`` for a `Task` in a module of yours
    that Python finds (``PYTHONPATH=.`` for one in the working directory).

    Raises:
        UnknownNameError: If there is no task of that name.
        RlcoError: If the module cannot be imported, or holds no such task, or the name
            is that of one of robosuite's own tasks.
        ConfigError: If the parts of a task of yours do not fit each other.

    Example:
        >>> make_task("push_cube").horizon
        120
        >>> make_task("rlco.physics.tasks.push_cube:TASK").name
        'push_cube'
    """
    if isinstance(task, Task):
        return check_task(task)
    if ":" in task:
        return check_task(_task_of_module(task))
    if task not in TASK_NAMES:
        raise UnknownNameError("task", task, sorted(TASK_NAMES))
    found: Task = importlib.import_module(f"rlco.physics.tasks.{task}").TASK
    return found


def _task_of_module(text: str) -> Task:
    if text.startswith("robosuite:"):
        raise RlcoError(
            f"{text!r} is robosuite's own task, without a scripted expert and "
            "domains, which make_env, sft, rl_co and evaluate take; here give one of "
            f"{', '.join(TASK_NAMES)}, or MODULE:NAME of yours."
        )
    return of_module(text, Task)
