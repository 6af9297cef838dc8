"""The tasks' names in Gymnasium's registry."""

from __future__ import annotations

import gymnasium

from rlco.physics.spec.names import TASK_NAMES


def gymnasium_id(task: str) -> str:
    """Return the id under which one of rlco's own tasks is registered.

    Example:
        >>> gymnasium_id("push_cube")
        'rlco/PushCube-v0'
    """
    return f"rlco/{''.join(part.capitalize() for part in task.split('_'))}-v0"


def register_tasks() -> None:
    """Register each of rlco's own tasks with Gymnasium; repeated calls have no effect.

    The environments end their own episodes, so no Gymnasium wrapper is needed for it.
    """
    for task in TASK_NAMES:
        if gymnasium_id(task) not in gymnasium.registry:
            gymnasium.register(
                gymnasium_id(task),
                entry_point="rlco.physics.tasks.gymnasium_env:TaskEnv",
                kwargs={"task": task},
            )


# Gymnasium loads no plugins by itself: the ids exist after this module is imported, or
# named in gymnasium.make("rlco.physics.tasks.registration:rlco/PushCube-v0").
register_tasks()
