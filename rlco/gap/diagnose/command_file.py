"""Write commands as a LeRobot v3 data set for LeRobot to replay, without torch."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from rlco.errors import OutputExistsError
from rlco.gap.logs.log import Array

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_FILE = "chunk-000/file-000.parquet"
_INDICES = ("frame_index", "episode_index", "index", "task_index")


def write_commands(
    path: str | Path,
    commands: Array,
    *,
    names: Sequence[str],
    fps: int,
    task: str,
) -> None:
    """Write one episode of commands.

    ``lerobot-replay --dataset.root=PATH --dataset.episode=0`` sends its `action` to a
    robot whose motors have these names and use these units.

    Args:
        path: The new folder.
        commands: Goals of the actuators, one row per frame, (T, actuators).
        names: Names of the actuators.
        fps: Frame rate [1/s].
        task: Description of the motion.

    Raises:
        OutputExistsError: If the folder exists.

    Example:
        >>> import tempfile
        >>> from rlco.lerobot_files import read_folder
        >>> folder = Path(tempfile.mkdtemp()) / "commands"
        >>> write_commands(folder, np.zeros((40, 2)), names="ab", fps=20, task="rest")
        >>> read_folder(folder).episodes[0].length
        40
    """
    path = Path(path)
    if path.exists():
        raise OutputExistsError(path)
    rows = len(commands)
    columns: dict[str, Any] = {
        "action": np.asarray(commands, dtype=np.float32),
        "timestamp": (np.arange(rows) / fps).astype(np.float32),
        "frame_index": np.arange(rows),
        "episode_index": np.zeros(rows, dtype=np.int64),
        "index": np.arange(rows),
        "task_index": np.zeros(rows, dtype=np.int64),
    }
    for folder in ("data/chunk-000", "meta/episodes/chunk-000"):
        (path / folder).mkdir(parents=True)
    vectors = pa.list_(pa.float32(), len(names))
    action = pa.array(columns["action"].tolist(), vectors)
    rest = {name: pa.array(value) for name, value in list(columns.items())[1:]}
    pq.write_table(pa.table({"action": action, **rest}), path / "data" / _FILE)
    stats = {name: _stats(value) for name, value in columns.items()}
    _write_json(path / "meta/info.json", _info(rows, names, fps))
    _write_json(path / "meta/stats.json", stats)
    pq.write_table(_tasks(task), path / "meta/tasks.parquet")
    episode: dict[str, Any] = {
        "episode_index": [0],
        "tasks": [[task]],
        "length": [rows],
        "data/chunk_index": [0],
        "data/file_index": [0],
        "dataset_from_index": [0],
        "dataset_to_index": [rows],
    }
    for name, found in stats.items():
        episode |= {f"stats/{name}/{key}": [value] for key, value in found.items()}
    episode |= {"meta/episodes/chunk_index": [0], "meta/episodes/file_index": [0]}
    pq.write_table(pa.table(episode), path / "meta/episodes" / _FILE)


def _info(rows: int, names: Sequence[str], fps: int) -> dict[str, Any]:
    def feature(kind: str) -> dict[str, Any]:
        return {"dtype": kind, "shape": [1], "names": None}

    action = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
    return {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": 1,
        "total_frames": rows,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": "0:1"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {
            "action": action,
            "timestamp": feature("float32"),
            **{name: feature("int64") for name in _INDICES},
        },
    }


def _tasks(text: str) -> pa.Table:
    """Return the table of task texts, which LeRobot reads as a pandas index."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {
            "name": name,
            "field_name": name,
            "pandas_type": pandas_type,
            "numpy_type": numpy_type,
            "metadata": None,
        }
        for name, (pandas_type, numpy_type) in kinds.items()
    ]
    described = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    table = pa.table({"task_index": [0], "task": [text]})
    return table.replace_schema_metadata({"pandas": json.dumps(described)})


def _stats(values: Array) -> dict[str, list[float]]:
    rows = np.asarray(values, dtype=float).reshape(len(values), -1)
    found: dict[str, list[float]] = {
        "min": rows.min(0).tolist(),
        "max": rows.max(0).tolist(),
        "mean": rows.mean(0).tolist(),
        "std": rows.std(0).tolist(),
        "count": [len(rows)],
    }
    return found | {
        name: np.quantile(rows, part, axis=0).tolist()
        for name, part in _QUANTILES.items()
    }


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=4), "utf-8")
