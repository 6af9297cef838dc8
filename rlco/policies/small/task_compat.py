"""Whether a policy was made for a task."""

from __future__ import annotations

import os
from typing import Any, Protocol

from rlco.errors import CheckpointError
from rlco.policies.small.checkpoint import load_unchecked
from rlco.policies.small.chunk_policy import ChunkPolicy


class DescribedTask(Protocol):
    """What a policy needs to know of a task: a simulator's, or data's alone."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def instructions(self) -> tuple[str, ...]:
        """Every instruction there is."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """One name a number of the state."""

    @property
    def environment_state_names(self) -> tuple[str, ...]:
        """One name a number of the environment's state."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """One name a number of an action."""


def task_sizes(task: DescribedTask) -> dict[str, int]:
    """Return what a task's policies and critics read, by their arguments' names.

    Example:
        >>> from rlco.physics.tasks.make_task import make_task
        >>> task_sizes(make_task("push_cube"))
        {'state_size': 7, 'environment_state_size': 12, 'num_instructions': 3}
    """
    return {
        "state_size": len(task.state_names),
        "environment_state_size": len(task.environment_state_names),
        "num_instructions": len(task.instructions),
    }


def load_task_policy(
    folder: str | os.PathLike[str], task: DescribedTask
) -> ChunkPolicy:
    """Load a saved policy that must read what the task shows.

    One that sees images may have been built without object poses.

    Raises:
        CheckpointError: it cannot be loaded, or reads something else.
    """
    policy, extra = load_unchecked(folder)
    if "task" in extra and extra["task"] is None:
        raise CheckpointError(
            f"policy {str(folder)!r} was trained without a simulator (task=null), and "
            f"{task.name!r} is one; run it by load_policy on your robot, or train with "
            "data of a task that has a simulator."
        )
    arguments: dict[str, Any] = policy.arguments
    sizes = task_sizes(task) | {"action_size": len(task.action_names)}
    for name, size in sizes.items():
        unread = name == "environment_state_size" and policy.image_size is not None
        if arguments[name] != size and not (unread and arguments[name] == 0):
            raise CheckpointError(
                f"policy {str(folder)!r} was trained on {extra.get('task')!r} with "
                f"{name}={arguments[name]}, but {task.name!r} has {size}; give the "
                "policy's own task=, or a policy of this task."
            )
    return policy
