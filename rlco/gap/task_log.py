"""Recordings of a task's own actions, from data sets and from arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rlco.gap.log import Array, Log, Recording
from rlco.lerobot_files import read_columns, read_folder
from rlco.physics.observation import ACTION_NAMES, STATE_NAMES
from rlco.physics.task import Task

_STATE, _SCENE = "observation.state", "observation.environment_state"


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
        state_names: One name a number of the state.

    Example:
        >>> from rlco.physics.push_cube import TASK
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
        seen = np.asarray(environment_state, dtype=float).T
        extra |= dict(zip(task.environment_state_names, seen, strict=True))
    return Recording(name, time, command=command, extra=extra)


def read_task_log(
    path: str | Path,
    task: Task,
    *,
    rename: Mapping[str, str] | None = None,
    episodes: Iterable[int] | None = None,
) -> Log:
    """Read a LeRobot folder, v2.1 or v3, of a task's own actions.

    Args:
        path: The folder.
        task: The task.
        rename: From a feature's name in the folder to ours.
        episodes: Those to read; all by default.

    Raises:
        DataError: If the folder cannot be read, or lacks state or action.
    """
    folder = read_folder(path, rename=rename, episodes=episodes)
    state, names = folder.feature(_STATE), [_STATE, "action", "timestamp"]
    with_scene = _SCENE in folder.features and (
        folder.feature(_SCENE).size == len(task.environment_state_names)
    )
    columns = read_columns(folder, names + [_SCENE] * with_scene)
    state_names = state.names or default_state_names(state.size)
    recordings, first = [], 0
    for episode in folder.episodes:
        rows = slice(first, first + episode.length)
        first += episode.length
        recordings.append(
            task_recording(
                task,
                f"episode {episode.index}",
                state=columns[_STATE][rows],
                action=columns["action"][rows],
                environment_state=columns[_SCENE][rows] if with_scene else None,
                time=np.asarray(columns["timestamp"][rows], dtype=float),
                state_names=state_names,
            )
        )
    return Log(tuple(recordings), actuators=ACTION_NAMES)


def default_state_names(size: int) -> tuple[str, ...]:
    """Return names for a state whose data set gives none.

    Example:
        >>> default_state_names(8)[-1]
        'state.7'
    """
    if size == len(STATE_NAMES):
        return STATE_NAMES
    return tuple(f"state.{i}" for i in range(size))
