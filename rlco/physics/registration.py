"""The tasks' names in Gymnasium's registry."""

from __future__ import annotations

import gymnasium

from rlco.physics.task import TASK_NAMES


def gymnasium_id(task: str) -> str:
    """Return the id under which one of rlco's own tasks is registered.

    Example:
        >>> gymnasium_id("push_cube")
        'rlco/PushCube-v0'
    """
    return f"rlco/{''.join(part.capitalize() for part in task.split('_'))}-v0"


def register_tasks() -> None:
    """Register each of rlco's own tasks with Gymnasium; again changes nothing.

    The environments end their own episodes, so that no wrapper of Gymnasium does.
    """
    for task in TASK_NAMES:
        if gymnasium_id(task) not in gymnasium.registry:
            gymnasium.register(
                gymnasium_id(task),
                entry_point="rlco.physics.gymnasium_env:TaskEnv",
                kwargs={"task": task},
            )


# Gymnasium loads no plugins by itself: whoever imports this module, or names it in
# gymnasium.make("rlco.physics.registration:rlco/PushCube-v0"), has the ids.
register_tasks()
