"""Recordings of a task's own actions, from arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from rlco.gap.logs.log import Array, Recording
from rlco.physics.spec.names import STATE_NAMES
from rlco.physics.spec.task import Task


def task_recording(
    task: Task,
    name: str,
    *,
    state: ArrayLike,
    action: ArrayLike,
    environment_state: ArrayLike | None = None,
    time: Array | None = None,
    state_names: Sequence[str] = STATE_NAMES,
) -> Recording:
    """Return a recording of a task from arrays; T rows.

    Args:
        task: The task; at its rate where no times are given.
        name: For reports.
        state: The robot's state, (T, S).
        action: The task's actions, (T, 7).
        environment_state: Named by the task, (T, E), [m].
        time: (T,), [s].
        state_names: One name per dimension of the state.

    Example:
        >>> from rlco.physics.tasks.push_cube import TASK
        >>> rows = np.zeros((3, 7))
        >>> recording = task_recording(TASK, "one", state=rows, action=rows)
        >>> recording.time.tolist(), list(recording.extra)[:2]
        ([0.0, 0.05, 0.1], ['tool.x', 'tool.y'])
    """
    command = np.asarray(action, dtype=float)
    if time is None:
        time = np.arange(len(command)) / task.control_frequency
    extra = dict(zip(state_names, np.asarray(state, dtype=float).T, strict=True))
    if environment_state is not None:
        observed = np.asarray(environment_state, dtype=float).T
        extra |= dict(zip(task.environment_state_names, observed, strict=True))
    return Recording(name, time, command=command, extra=extra)
