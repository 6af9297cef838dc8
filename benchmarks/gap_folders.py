"""Case folders: a model, a LeRobot v3 folder of recordings, and the truth.

Written with pyarrow alone: lerobot's own writer takes ten seconds to import.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from gap_arms import Array

_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_COUNTERS = ("frame_index", "episode_index", "index", "task_index")


def write_case(
    folder: Path,
    xml: str,
    episodes: Sequence[Mapping[str, Array]],
    fps: int,
    joints: Sequence[str],
    truth: Mapping[str, Any],
) -> None:
    """Write a case to a new folder; `truth.json` last, so that it marks a whole one.

    Args:
        folder: Made, with its parents.
        xml: The nominal model.
        episodes: Of each, the features by their LeRobot names, (frames, joints).
        fps: Frames a second [1/s].
        joints: Names of the columns.
        truth: What was hidden, and how it was recorded.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(xml)
    write_lerobot(folder / "data", episodes, fps, joints, str(truth["motion"]))
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))


def write_lerobot(
    folder: Path,
    episodes: Sequence[Mapping[str, Array]],
    fps: int,
    joints: Sequence[str],
    task: str,
) -> None:
    """Write episodes of named numbers as one LeRobot v3 folder."""
    lengths = [len(episode["action"]) for episode in episodes]
    ends = np.cumsum(lengths)
    columns: dict[str, Any] = {}
    for name in episodes[0]:
        whole = np.concatenate([episode[name] for episode in episodes])
        columns[name] = _lists(whole.astype(np.float32))
    frame = np.concatenate([np.arange(length) for length in lengths])
    columns["timestamp"] = (frame / fps).astype(np.float32)
    columns["frame_index"] = frame
    columns["episode_index"] = np.repeat(np.arange(len(lengths)), lengths)
    columns["index"] = np.arange(ends[-1])
    columns["task_index"] = np.zeros(ends[-1], dtype=np.int64)
    _table(folder / _DATA.format(chunk_index=0, file_index=0), columns)
    first = {
        "episode_index": np.arange(len(lengths)),
        "tasks": [[task]] * len(lengths),
        "length": np.array(lengths),
        "data/chunk_index": np.zeros(len(lengths), dtype=np.int64),
        "data/file_index": np.zeros(len(lengths), dtype=np.int64),
        "dataset_from_index": ends - np.array(lengths),
        "dataset_to_index": ends,
        "meta/episodes/chunk_index": np.zeros(len(lengths), dtype=np.int64),
        "meta/episodes/file_index": np.zeros(len(lengths), dtype=np.int64),
    }
    _table(folder / "meta/episodes/chunk-000/file-000.parquet", first)
    # As pandas keeps a table whose index is the task's name.
    _table(folder / "meta/tasks.parquet", {"task_index": [0], "task": [task]}, "task")
    info = _info(episodes[0], fps, joints, len(lengths), int(ends[-1]))
    (folder / "meta/info.json").write_text(json.dumps(info, indent=4))
    stats = _stats(columns)
    (folder / "meta/stats.json").write_text(json.dumps(stats, indent=4))


def _lists(rows: Array) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(rows).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, rows.shape[1])


def _table(path: Path, columns: Mapping[str, Any], index: str | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    if index is not None:
        pandas = json.dumps({"index_columns": [index], "columns": []})
        table = table.replace_schema_metadata({"pandas": pandas})
    pq.write_table(table, path)


def _info(
    episode: Mapping[str, Array],
    fps: int,
    joints: Sequence[str],
    episodes: int,
    frames: int,
) -> dict[str, Any]:
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(joints)], "names": list(joints)}
        for name in episode
    }
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    for name in _COUNTERS:
        features[name] = {"dtype": "int64", "shape": [1], "names": None}
    return {
        "codebase_version": "v3.0",
        "fps": fps,
        "features": features,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "robot_type": None,
        "splits": {"train": f"0:{episodes}"},
    }


def _stats(columns: Mapping[str, Any]) -> dict[str, Any]:
    stats = {}
    for name, values in columns.items():
        rows = np.stack(values.to_pylist()) if isinstance(values, pa.Array) else values
        rows = np.asarray(rows, dtype=float).reshape(len(rows), -1)
        numbers = {
            "min": rows.min(0),
            "max": rows.max(0),
            "mean": rows.mean(0),
            "std": rows.std(0),
        }
        stats[name] = {kind: value.tolist() for kind, value in numbers.items()}
        stats[name]["count"] = [len(rows)]
    return stats
