"""LeRobot data sets, v2.1 and v3: states, velocities, efforts and actions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from rlco.files import read_json
from rlco.gap.logs.formats.headers import parse_header
from rlco.gap.logs.log import Array
from rlco.gap.logs.table import Column, Kind, Table
from rlco.gap.model import LoadedModel
from rlco.lerobot_files import Feature, LeRobotFolder, read_columns, read_folder
from rlco.physics.spec.names import ACTION_NAMES, STATE_NAMES, TASK_NAMES

_KINDS: dict[str, Kind] = {
    "observation.state": "position",
    "observation.velocity": "velocity",
    "observation.effort": "torque",
    "observation.torque": "torque",
    "action": "command",
}
_COUNTERS = ("frame_index", "episode_index", "index", "task_index", "timestamp")
# A feature of more numbers is an image or a map, not a robot's channel.
_MOST = 128


def read_lerobot(
    path: Path, model: LoadedModel | None, rename: Mapping[str, str]
) -> tuple[list[Table], dict[str, str]]:
    """Read a folder's numbers, one table an episode.

    Returns:
        The tables, and what of `rename` named no feature and is left to be applied to
        names of joints and actuators.

    Raises:
        DataError: The folder is damaged, or has neither states nor actions.
    """
    stored = read_folder(path, episodes="present")
    features = {a: b for a, b in rename.items() if a in stored.features}
    folder = read_folder(path, rename=features, episodes="present")
    notes = _absent(folder)
    used = [name for name, f in folder.features.items() if _is_channel(name, f)]
    if "observation.state" not in used and "action" not in used:
        folder.feature("observation.state")
    columns = read_columns(folder, [*used, *_clock(folder)])
    ends = np.cumsum([episode.length for episode in folder.episodes])
    tables = []
    for episode, end in zip(folder.episodes, ends, strict=True):
        rows = slice(int(end) - episode.length, int(end))
        parts: list[tuple[Column, Array]] = []
        for name in used:
            values = np.asarray(columns[name][rows], dtype=float)
            values = values.reshape(episode.length, -1)
            described = _columns(name, folder.features[name], model)
            parts += [(column, values[:, i]) for i, column in enumerate(described)]
        stamps = columns["timestamp"][rows] if _clock(folder) else np.zeros(0)
        time = _time(folder, episode.length, np.asarray(stamps, dtype=float))
        name = f"episode {episode.index}"
        tables.append(Table(name, time, tuple(parts), {}, tuple(notes)))
    return tables, {a: b for a, b in rename.items() if a not in features}


def _absent(folder: LeRobotFolder) -> list[str]:
    """Note episodes that are listed and whose file is not there."""
    info = read_json(folder.path / "meta" / "info.json")
    listed = info.integer("total_episodes", 0)
    lost = listed - len(folder.episodes)
    return [f"Of {listed} listed episodes {lost} have no file."] if lost > 0 else []


def _is_channel(name: str, feature: Feature) -> bool:
    numbers = feature.dtype.startswith(("float", "int", "bool", "uint"))
    return numbers and name not in _COUNTERS and feature.size <= _MOST


def _columns(name: str, feature: Feature, model: LoadedModel | None) -> list[Column]:
    """Return what each number of a feature is."""
    default = _KINDS.get(name)
    names = feature.names or _default_names(name, feature.size, model)
    if default is None:
        # Names of a scene's numbers say what they are by themselves.
        whole = names if feature.names and feature.size > 1 else [name]
        whole = whole if len(whole) == feature.size else [f"{name}.{n}" for n in names]
        return [Column("extra", header, header) for header in whole]
    joints = () if model is None else model.joints
    actuators = () if model is None else model.actuators
    columns = []
    for number in names:
        meaning = parse_header(number, joints, actuators, default)
        # An action's name may say what it commands: ``shoulder_pan.pos``.
        sent = default == "command" and meaning.kind == "position"
        kind = "command" if sent else meaning.kind
        if default == "command" and kind in ("velocity", "torque"):
            kind = "extra"
        columns.append(Column(kind, meaning.stem, f"{name}.{number}", meaning.angles))
    return columns


def _default_names(name: str, size: int, model: LoadedModel | None) -> tuple[str, ...]:
    """Return names for numbers that have none: of a task's, what they always are."""
    own = model is not None and model.task in TASK_NAMES
    if own and name == "observation.state":
        return _default_state_names(size)
    if own and name == "action" and size == len(ACTION_NAMES):
        return ACTION_NAMES
    return tuple(str(i) for i in range(size))


def _clock(folder: LeRobotFolder) -> list[str]:
    return ["timestamp"] if "timestamp" in folder.features else []


def _time(folder: LeRobotFolder, rows: int, stamps: Array) -> Array:
    counted = np.arange(rows) / folder.fps
    if not stamps.size:
        return counted
    time = stamps.reshape(rows)
    # Recorders count frames and round the times to single precision.
    rounding = 1e-6 * max(1.0, float(np.abs(time).max()))
    exact = bool(np.abs(time - time[0] - counted).max() <= rounding)
    return counted if exact else time


def _default_state_names(size: int) -> tuple[str, ...]:
    """Return names for a state whose data set gives none."""
    if size == len(STATE_NAMES):
        return STATE_NAMES
    return tuple(f"state.{i}" for i in range(size))
