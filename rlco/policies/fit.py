"""Whether a policy was made for a task."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from rlco.errors import CheckpointError
from rlco.physics.task import Task
from rlco.policies.checkpoint import load_policy
from rlco.policies.chunk_policy import ChunkPolicy

if TYPE_CHECKING:  # robosuite takes a second to import
    from rlco.physics.robosuite_tasks import RobosuiteTask


def task_sizes(task: Task | RobosuiteTask) -> dict[str, int]:
    """Return what a task's policies and critics read, by their arguments' names.

    Example:
        >>> from rlco.physics.task import make_task
        >>> task_sizes(make_task("push_cube"))
        {'state_size': 7, 'environment_state_size': 12, 'num_instructions': 3}
    """
    return {
        "state_size": len(task.state_names),
        "environment_state_size": len(task.environment_state_names),
        "num_instructions": len(task.instructions),
    }


def load_task_policy(
    folder: str | os.PathLike[str], task: Task | RobosuiteTask
) -> ChunkPolicy:
    """Load a saved policy that must read what the task shows.

    One that sees pictures may have been built without object poses.

    Raises:
        CheckpointError: it cannot be loaded, or reads something else.
    """
    policy, extra = load_policy(folder)
    arguments: dict[str, Any] = policy.arguments
    for name, size in task_sizes(task).items():
        unread = name == "environment_state_size" and policy.image_size is not None
        if arguments[name] != size and not (unread and arguments[name] == 0):
            raise CheckpointError(
                f"policy {str(folder)!r} was trained on {extra.get('task')!r} with "
                f"{name}={arguments[name]}, but {task.name!r} has {size}; give the "
                "policy's own task=, or a policy of this task."
            )
    return policy
