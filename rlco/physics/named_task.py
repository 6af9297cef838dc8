"""Any task by its name: rlco's own, a user's, or one of robosuite's."""

from __future__ import annotations

from functools import cache

from rlco.physics.robosuite_tasks import PREFIX, RobosuiteTask, make_plain
from rlco.physics.task import Task, make_task


def named_task(task: str | Task) -> Task | RobosuiteTask:
    """Return what a task's name stands for, or the task itself.

    Args:
        task: ``push_cube``, ``MODULE:NAME`` or ``robosuite:Lift``.

    Raises:
        UnknownNameError: If there is no such task.

    Example:
        >>> named_task("robosuite:Lift").instructions
        ('lift the cube',)
    """
    if isinstance(task, str) and task.startswith(PREFIX):
        return _of_robosuite(task.removeprefix(PREFIX))
    return make_task(task)


@cache
def _of_robosuite(name: str) -> RobosuiteTask:
    env = make_plain(name)
    try:
        env.reset()
        return RobosuiteTask.of(name, env)
    finally:
        env.close()
