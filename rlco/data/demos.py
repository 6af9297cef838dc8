"""Demonstrations: a LeRobot folder as a TorchRL replay buffer."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, TensorDictReplayBuffer

from rlco.data.augment import Augmentation
from rlco.data.instructions import InstructionFromId
from rlco.data.resize import images_of
from rlco.errors import ConfigError, DataError, OutputExistsError, counted, suggest
from rlco.files import few, shown
from rlco.files.sizes import check_held
from rlco.keys import (
    ACTION,
    CHUNK,
    ENVIRONMENT_STATE,
    INSTRUCTION_ID,
    IS_PAD,
    STATE,
    image_keys,
)
from rlco.lerobot_files import (
    LARGEST,
    LeRobotFolder,
    check_stored_sizes,
    read_columns,
    read_folder,
)
from rlco.physics.rendering.image_size import check_image_size

_STATE = "observation.state"
_ENVIRONMENT_STATE = "observation.environment_state"
_ACTION = "action"


@dataclass(frozen=True)
class DemoMeta:
    """What a data set says of itself.

    Attributes:
        path: Its folder.
        fps: Frames a second [1/s].
        robot_type: The recorder's word for the robot, if any.
        state_names: One name a number of the state; empty where none are given.
        environment_state_names: The same for the environment's state.
        action_names: The same for the action.
        instructions: Texts in the order of their ids.
        episodes: The data set's own indices of the episodes loaded.
        episode_lengths: Their numbers of frames, in the same order.
        chunk: Steps H of an action chunk.
        image_key: The camera loaded, if any; of several, features by their names.
        recorded: How rlco recorded it: ``domain``, ``renderer``, ``look`` and so on;
            empty where another program did.
    """

    path: Path
    fps: float
    robot_type: str | None
    state_names: tuple[str, ...]
    environment_state_names: tuple[str, ...]
    action_names: tuple[str, ...]
    instructions: tuple[str, ...]
    episodes: tuple[int, ...]
    episode_lengths: tuple[int, ...]
    chunk: int
    image_key: str | Mapping[str, str] | None
    recorded: Mapping[str, Any]


class DemoReplayBuffer(TensorDictReplayBuffer):
    """A replay buffer of demonstrated frames, with what is known of them in ``meta``.

    One row a frame, raw units; see ``load_demos`` for the keys. The instruction's
    text is not stored but looked up from its id when rows are read.

    Set ``augmentation`` to change the images of the rows that ``sample`` draws, anew
    at each draw and from the buffer's own generator; ``frames`` and indexing give them
    as they were recorded.

    Args:
        meta: What the data set says of itself.
        storage: An empty TorchRL storage.
    """

    def __init__(
        self, meta: DemoMeta, storage: LazyTensorStorage | LazyMemmapStorage
    ) -> None:
        super().__init__(
            storage=storage, transform=InstructionFromId(meta.instructions)
        )
        self.meta = meta
        self.augmentation: Augmentation | None = None

    def sample(self, *args: Any, **options: Any) -> Any:
        """Draw rows, as TorchRL's buffers do, with images augmented where asked."""
        drawn = super().sample(*args, **options)
        if self.augmentation is not None:
            rows = drawn[0] if isinstance(drawn, tuple) else drawn
            for key in _image_keys(self.meta.image_key):
                rows.set(key, self.augmentation(rows.get(key), self._rng))
        return drawn

    def frames(self) -> TensorDictBase:
        """Return every frame in order, shape [frames].

        Its tensors are the stored ones: read them, or clone before writing.
        """
        return self[:]


def load_demos(
    path: str | Path,
    *,
    chunk: int = 1,
    episodes: Iterable[int] | None = None,
    rename: Mapping[str, str] | None = None,
    instructions: Sequence[str] | None = None,
    action_dim: int | None = None,
    state_dim: int | None = None,
    environment_dim: int | None = None,
    image_key: str | Mapping[str, str] | Literal[False] | None = None,
    image_size: tuple[int, int] | None = None,
    memmap: str | Path | None = None,
) -> DemoReplayBuffer:
    """Load a local LeRobot folder (v2.1 or v3) into a replay buffer.

    Each row holds, in raw units: ``("observation", "state")`` float32 [S],
    ``("observation", "environment_state")`` float32 [E] where the set has it,
    ``("observation", "image")`` uint8 [3, height, width] where a camera is read,
    ``action`` float32 [A], ``("vla_action", "chunk")`` float32 [H, A] (this frame's
    action and the next H - 1; past the episode's end the last one is repeated),
    ``action_is_pad`` bool [H] (True there), ``instruction_id`` int64,
    ``language_instruction``, ``episode`` and ``frame`` int64.

    Args:
        path: The data set's folder.
        chunk: Steps H of an action chunk. Chunks never cross episodes.
        episodes: Indices of the episodes to load; None for all.
        rename: ``{"their.name": "our.name"}``, for example
            ``{"actions": "action", "state": "observation.state"}``.
        instructions: Texts that give ``instruction_id`` its meaning, in the order of
            their ids; None takes the data set's own tasks in their order.
        action_dim: The action's size that is expected, checked.
        state_dim: The same for the state.
        environment_dim: The same for the environment's state, which then must exist.
        image_key: The camera to read, for example ``"observation.images.front"``.
            None reads the camera where there is exactly one; False reads none. A map
            ``{"wrist": "observation.images.hand"}`` reads several, each under
            ``("observation", "image", NAME)``.
        image_size: Height and width of the images [pixels]: cut about their middle
            to this shape, then made smaller. None leaves them as they are.
        memmap: A new folder for the rows, memory-mapped; None keeps them in memory.

    Raises:
        DataError: The data set cannot be used as it is, or what is to be loaded needs
            more than half of the memory; the message says why.
        ConfigError: ``chunk`` is not a positive integer.
        RlcoError: `image_size` is no height and width.
        OutputExistsError: The ``memmap`` folder exists.
    """
    if chunk < 1:
        raise ConfigError([f"chunk={chunk}, but a chunk has at least 1 step"])
    check_image_size(image_size)
    if memmap is not None and Path(memmap).exists():
        raise OutputExistsError(memmap)
    folder = read_folder(path, episodes=episodes, rename=rename)
    sizes = {
        _STATE: state_dim,
        _ACTION: action_dim,
        _ENVIRONMENT_STATE: environment_dim,
    }
    _check_sizes(folder, sizes)
    check_stored_sizes(folder, [name for name in sizes if name in folder.features])
    camera = _choose_camera(folder, image_key)
    features = list(camera.values()) if isinstance(camera, Mapping) else [camera]
    _check_memory(folder, chunk, features, image_size, memmap)
    texts = tuple(folder.tasks[i] for i in sorted(folder.tasks))
    if instructions is not None:
        texts = tuple(instructions)
    rows = _numeric_rows(folder, chunk, texts)
    total = len(rows)
    storage = (
        LazyTensorStorage(total)
        if memmap is None
        else LazyMemmapStorage(total, scratch_dir=str(memmap))
    )
    buffer = DemoReplayBuffer(_meta(folder, texts, chunk, camera), storage)
    with _without_storage_lines():
        if camera is None:
            buffer.extend(rows)
            return buffer
        start = 0
        films = [images_of(folder, str(one), image_size) for one in features]
        for views in zip(*films, strict=True):
            # One episode at a time: a memory map never holds all images in memory.
            part = rows[start : start + len(views[0])]
            for key, images in zip(_image_keys(camera), views, strict=True):
                part.set(key, images)
            buffer.extend(part)
            start += len(part)
    return buffer


def _image_keys(camera: str | Mapping[str, str] | None) -> tuple[tuple[str, ...], ...]:
    """Return the keys of what `load_demos` read of a camera, or of several."""
    if camera is None:
        return ()
    return image_keys(list(camera) if isinstance(camera, Mapping) else [camera])


@contextlib.contextmanager
def _without_storage_lines() -> Iterator[None]:
    """Leave out what TorchRL logs as a storage gets its first rows, and no more."""

    def other(record: logging.LogRecord) -> bool:
        return not str(record.msg).startswith("Initialized Lazy")

    logger = logging.getLogger("torchrl")
    logger.addFilter(other)
    try:
        yield
    finally:
        logger.removeFilter(other)


def chunk_indices(
    lengths: Sequence[int], chunk: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return which frames make each frame's chunk, and which of them are padding.

    Args:
        lengths: Frames of each episode, one after the other.
        chunk: Steps H of a chunk.

    Returns:
        Frame indices int64 [frames, H] and padding bool [frames, H].

    Example:
        >>> index, is_pad = chunk_indices([2, 1], chunk=2)
        >>> index.tolist(), is_pad.tolist()
        ([[0, 1], [1, 1], [2, 2]], [[False, False], [False, True], [False, True]])
    """
    length = torch.tensor(list(lengths))
    last = (length.cumsum(0) - 1).repeat_interleave(length)[:, None]
    wanted = torch.arange(int(length.sum()))[:, None] + torch.arange(chunk)
    return wanted.minimum(last), wanted > last


def _numeric_rows(
    folder: LeRobotFolder, chunk: int, texts: tuple[str, ...]
) -> TensorDict:
    stored = {STATE: _STATE, ACTION: _ACTION}
    if _ENVIRONMENT_STATE in folder.features:
        stored[ENVIRONMENT_STATE] = _ENVIRONMENT_STATE
    names = [*stored.values(), "task_index", "episode_index", "frame_index"]
    columns = {
        name: torch.from_numpy(np.ascontiguousarray(column))
        for name, column in read_columns(folder, names, largest=LARGEST).items()
    }
    total = len(columns["frame_index"])
    rows = TensorDict(batch_size=[total])
    for key, name in stored.items():
        rows.set(key, columns[name].float().reshape(total, -1))
    index, is_pad = chunk_indices([e.length for e in folder.episodes], chunk)
    rows.set(CHUNK, rows.get(ACTION)[index])
    rows.set(IS_PAD, is_pad)
    rows.set(INSTRUCTION_ID, _instruction_ids(folder, columns["task_index"], texts))
    rows.set("episode", columns["episode_index"].long())
    rows.set("frame", columns["frame_index"].long())
    return rows


def _instruction_ids(
    folder: LeRobotFolder, tasks: torch.Tensor, texts: tuple[str, ...]
) -> torch.Tensor:
    used, inverse = np.unique(tasks.numpy(), return_inverse=True)
    ids = []
    for index in used.tolist():
        text = folder.tasks.get(index)
        if text is None:
            raise DataError(
                f"data set {str(folder.path)!r} has frames of task {index}, which its "
                "list of tasks lacks; copy the data set again."
            )
        if text not in texts:
            raise DataError(
                f"data set {str(folder.path)!r} has frames with the instruction "
                f"{shown(text)}{suggest(text, texts)}, which is not among the known "
                f"ones: {few([repr(known) for known in texts])}; add it, or leave "
                "these episodes out."
            )
        ids.append(texts.index(text))
    return torch.tensor(ids)[torch.from_numpy(inverse)]


def _check_sizes(folder: LeRobotFolder, sizes: Mapping[str, int | None]) -> None:
    for name, size in sizes.items():
        if name == _ENVIRONMENT_STATE and size is None:
            continue
        feature = folder.feature(name)
        if size is not None and feature.size != size:
            raise DataError(
                f"feature {name!r} of data set {str(folder.path)!r} has "
                f"{counted(feature.size, 'number')}, but {size} are expected; give a "
                "data set of the same robot and task, or rename= the feature that is "
                "meant (sft trains on another robot's data with task=null)."
            )


def _check_memory(
    folder: LeRobotFolder,
    chunk: int,
    cameras: Sequence[str | None],
    image_size: tuple[int, int] | None,
    memmap: str | Path | None,
) -> None:
    """Check that there is memory for all chunks, and for images that stay in memory."""
    frames = sum(episode.length for episode in folder.episodes)
    whole = f"of the {frames} frames of data set {str(folder.path)!r}"
    # Its actions (float32), where they come from (int64, twice) and what is padding.
    step = 4 * folder.feature(_ACTION).size + 17
    check_held(
        frames * chunk * step,
        f"chunks of {chunk} steps {whole}",
        "give a smaller chunk=, or some of the episodes with episodes=",
    )
    if memmap is None:
        pixels = [
            folder.feature(one).size if image_size is None else 3 * prod(image_size)
            for one in cameras
            if one is not None
        ]
        check_held(
            frames * sum(pixels),
            f"the images {whole}",
            "give memmap= a new folder to keep them in, a smaller image_size=, or some "
            "of the episodes with episodes=",
        )


def _choose_camera(
    folder: LeRobotFolder, image_key: str | Mapping[str, str] | Literal[False] | None
) -> str | Mapping[str, str] | None:
    if image_key is None and len(folder.cameras) == 1:
        return folder.cameras[0]
    if not image_key:
        return None
    chosen = [image_key] if isinstance(image_key, str) else list(image_key.values())
    for feature in chosen:
        folder.feature(feature)
    return image_key


def _meta(
    folder: LeRobotFolder,
    texts: tuple[str, ...],
    chunk: int,
    camera: str | Mapping[str, str] | None,
) -> DemoMeta:
    def names(name: str) -> tuple[str, ...]:
        return (folder.features[name].names or ()) if name in folder.features else ()

    return DemoMeta(
        path=folder.path,
        fps=folder.fps,
        robot_type=folder.robot_type,
        state_names=names(_STATE),
        environment_state_names=names(_ENVIRONMENT_STATE),
        action_names=names(_ACTION),
        instructions=texts,
        episodes=tuple(episode.index for episode in folder.episodes),
        episode_lengths=tuple(episode.length for episode in folder.episodes),
        chunk=chunk,
        image_key=camera,
        recorded=folder.recorded,
    )
