"""Demonstrations of a task, checked against what the task's policies need."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rlco.data.demos import DemoReplayBuffer, load_demos
from rlco.errors import DataError
from rlco.options import rename_map
from rlco.physics.task import Task

if TYPE_CHECKING:  # robosuite takes a second to import
    from rlco.physics.robosuite_tasks import RobosuiteTask


def load_task_demos(
    path: str | Path, task: Task | RobosuiteTask, *, chunk: int, rename: str = ""
) -> DemoReplayBuffer:
    """Load demonstrations whose features, sizes, texts and rate are the task's.

    Args:
        path: A LeRobot folder, v2.1 or v3.
        task: The task; its instructions give the ids.
        chunk: Steps H of an action chunk.
        rename: Features with other names, as `rename_map` reads them.

    Raises:
        ConfigError: `rename` cannot be read.
        DataError: The data set cannot be used, or was recorded at another rate.
    """
    demos = load_demos(
        path,
        chunk=chunk,
        rename=rename_map(rename),
        instructions=task.instructions,
        action_dim=len(task.action_names),
        state_dim=len(task.state_names),
        environment_dim=len(task.environment_state_names),
        image_key=False,
    )
    if demos.meta.fps != task.control_frequency:
        raise DataError(
            f"data set {str(path)!r} has {demos.meta.fps:g} frames a second, but "
            f"{task.name!r} is controlled at {task.control_frequency} Hz; record or "
            "resample it at that rate, as an action chunk counts frames."
        )
    return demos
