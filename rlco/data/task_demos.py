"""Demonstrations of a task, checked against what the task's policies need."""

from __future__ import annotations

import math
import shutil
import tempfile
import weakref
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rlco.data.demos import DemoReplayBuffer, load_demos
from rlco.data.recorded_task import RecordedTask
from rlco.errors import DataError, suggest
from rlco.files import few
from rlco.keys import ACTION
from rlco.lerobot_files import LeRobotFolder, read_folder
from rlco.physics.rendering.image_size import check_image_size
from rlco.physics.spec.actions import TOLERANCE
from rlco.physics.spec.task import Task
from rlco.runs.options import rename_map

if TYPE_CHECKING:  # robosuite takes a second to import
    from rlco.physics.robosuite.tasks import RobosuiteTask

PREFIX = "observation.images."
#: Images beyond this are kept in a temporary file and read as they are drawn [bytes].
IN_MEMORY = 2**30


def load_task_demos(
    path: str | Path,
    task: Task | RobosuiteTask | RecordedTask,
    *,
    chunk: int,
    episodes: Iterable[int] | None = None,
    rename: str = "",
    image_size: tuple[int, int] | None = None,
    camera: str | None = None,
    cameras: Sequence[str] = ("agentview",),
    environment_state: bool = True,
) -> DemoReplayBuffer:
    """Load demonstrations whose features, sizes, texts and rate are the task's.

    Args:
        path: A LeRobot folder, v2.1 or v3.
        task: The task; its instructions give the ids.
        chunk: Steps H of an action chunk.
        episodes: Indices of the episodes to load; None: all.
        rename: Features with other names, as `rename_map` reads them.
        image_size: Height and width of the images [pixels]; None reads none. More
            than a gigabyte of them is memory-mapped, in a folder that goes with the
            buffer.
        camera: Which images: ``front``, or the feature's whole name; None: those of
            the only camera. Of several cameras ``front,wrist``; None: those that are
            named as `cameras` are.
        cameras: What the cameras are called in rows, where there are several.
        environment_state: Whether object poses must be there.

    Raises:
        ConfigError: `rename` cannot be read.
        DataError: The data set cannot be used, was recorded at another rate, or has
            actions beyond the task's limit.
        RlcoError: `image_size` is no height and width.
    """
    check_image_size(image_size)
    names = rename_map(rename)
    key: str | dict[str, str] | Literal[False] = False
    memmap = None
    if image_size is not None:
        folder = read_folder(path, episodes=episodes, rename=names)
        key = camera_keys(folder, camera, cameras)
        frames = sum(episode.length for episode in folder.episodes)
        if 3 * math.prod(image_size) * frames * len(cameras) > IN_MEMORY:
            memmap = Path(tempfile.mkdtemp(prefix="rlco_rows_")) / "rows"
    environment_dim = len(task.environment_state_names) if environment_state else None
    try:
        demos = load_demos(
            path,
            chunk=chunk,
            episodes=episodes,
            rename=names,
            instructions=task.instructions,
            action_dim=len(task.action_names),
            state_dim=len(task.state_names),
            environment_dim=environment_dim,
            image_key=key,
            image_size=image_size,
            memmap=memmap,
        )
    except BaseException:
        if memmap is not None:
            shutil.rmtree(memmap.parent, ignore_errors=True)
        raise
    if memmap is not None:
        weakref.finalize(demos, shutil.rmtree, memmap.parent, ignore_errors=True)
    check_commands(demos, task)
    return demos


def check_commands(
    demos: DemoReplayBuffer, task: Task | RobosuiteTask | RecordedTask
) -> None:
    """Check that what demonstrations command is what a task's robot is commanded.

    Raises:
        DataError: They have another rate, or actions beyond the task's limit.
    """
    where = f"data set {str(demos.meta.path)!r}"
    if demos.meta.fps != task.control_frequency:
        raise DataError(
            f"{where} has {demos.meta.fps:g} frames per second, but "
            f"{task.name!r} is controlled at {task.control_frequency} Hz; record or "
            "resample it at that rate, as an action chunk counts frames."
        )
    if task.action_limit is None:
        return
    actions = demos.frames()[ACTION]
    beyond = actions.abs() > task.action_limit + TOLERANCE
    if beyond.any():
        number = int(actions.abs().amax(0).argmax())
        low, high = float(actions[:, number].min()), float(actions[:, number].max())
        name, limit = task.action_names[number], task.action_limit
        raise DataError(
            f"{where} has actions from {low:.4g} to {high:.4g} under {name!r} (number "
            f"{number}), and {int(beyond.any(1).sum())} of {len(actions)} frames "
            f"beyond [-{limit:g}, {limit:g}], to which {task.name!r} would clip them; "
            "divide each number by the largest move that 1 stands for, leave out the "
            "episodes (episodes=), or train a robot that is commanded otherwise with "
            "task=null."
        )


def camera_keys(
    folder: LeRobotFolder, camera: str | None, cameras: Sequence[str]
) -> str | dict[str, str]:
    """Return the feature of one camera, or of several by their names in rows.

    Args:
        folder: The data set.
        camera: See `load_task_demos`.
        cameras: See `load_task_demos`.

    Raises:
        DataError: See `camera_key`, or another number of cameras is named.
    """
    if len(cameras) == 1:
        return camera_key(folder, camera)
    names = cameras if camera is None else [one.strip() for one in camera.split(",")]
    if len(names) != len(cameras):
        raise DataError(
            f"{len(cameras)} cameras are read, {', '.join(cameras)}, but camera="
            f"{camera} names {len(names)}; name one for each, in this order."
        )
    return {
        ours: camera_key(folder, name)
        for ours, name in zip(cameras, names, strict=True)
    }


def camera_key(folder: LeRobotFolder, camera: str | None) -> str:
    """Return the feature that holds a camera's images.

    Raises:
        DataError: There are no images, or none of that camera, or of several.
    """
    where = f"data set {str(folder.path)!r}"
    if not folder.cameras:
        raise DataError(
            f"{where} has no images; record them (record_demos: camera=agentview "
            "image_size=64), or give image=none."
        )
    short = [name.removeprefix(PREFIX) for name in folder.cameras]
    if camera is None and len(short) == 1:
        return folder.cameras[0]
    for name, key in zip(short, folder.cameras, strict=True):
        if camera in (name, key):
            return key
    if camera is None:
        raise DataError(
            f"{where} has several cameras, {few(short)}; say which by "
            f"real_camera={short[0]}."
        )
    raise DataError(
        f"{where} has no camera {camera!r}{suggest(camera, short)}; it has "
        f"{few(short)}."
    )
