"""Whether the robosuite objects of a task are those that it names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rlco.errors import ConfigError
from rlco.physics.spec.task import Task


def check_objects(
    task: Task, objects: Sequence[Any], variation: str | None = None
) -> None:
    """Check what a task's ``make_objects`` returned.

    Args:
        task: The task.
        objects: robosuite's objects.
        variation: The variation that they were made for.

    Raises:
        ConfigError: They are not the task's objects and goals, in this order; one has a
            free joint that should not, or none that should; or a start has another
            number of poses.
    """
    wanted = [*task.objects, *task.goals]
    names = [one.name for one in objects]
    if names[: len(wanted)] != wanted:
        raise ConfigError(
            [
                f"task {task.name!r}: make_objects returns {', '.join(names)}; it must "
                f"return objects and then goals, {', '.join(wanted)}, before what a "
                "variation adds"
            ]
        )
    problems = []
    for place, one in enumerate(objects):
        goal = len(task.objects) <= place < len(wanted)
        moves = _moves_freely(one)
        if goal and moves:
            problems.append(
                f"task {task.name!r}: {one.name!r} is one of goals, which nothing "
                "moves, but its body has a joint; build it with joints=None, or list "
                "it in objects"
            )
        elif not goal and not moves:
            problems.append(
                f"task {task.name!r}: {one.name!r} needs a free joint, robosuite's "
                "default, since it can be moved; list what nothing moves in goals"
            )
    if problems:
        raise ConfigError(problems)
    loose = [*names[: len(task.objects)], *names[len(wanted) :]]
    start = task.sample(np.random.default_rng(0), variation)
    if len(start.object_pose) != len(loose):
        given = "" if variation is None else f" with variation={variation!r}"
        raise ConfigError(
            [
                f"task {task.name!r}: sample{given} gives {len(start.object_pose)} "
                f"rows of object_pose, but make_objects returns {len(loose)} objects "
                f"that move: {', '.join(loose)}"
            ]
        )


def _moves_freely(one: Any) -> bool:
    """Return whether the root of a robosuite object has a joint."""
    return any(child.tag in ("joint", "freejoint") for child in one.get_obj())
