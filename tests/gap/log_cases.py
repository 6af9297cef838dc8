"""A small arm, a motion of it, and the same log written in several formats."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from rlco.gap.log import Array
from rlco.gap.model import LoadedModel, load_model

SHARED = Path(__file__).parents[2].parent / "shared" / "data"
JOINTS = ("shoulder", "elbow", "wrist")
ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" range="-2 2" limited="true"/>
      <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>
      <body name="lower" pos=".2 0 0">
        <joint name="elbow" axis="0 1 0" range="-2.5 0.5" limited="true"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>
        <body name="hand" pos=".2 0 0">
          <joint name="wrist" axis="1 0 0" range="-3 3" limited="true"/>
          <geom size=".03"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="m1" joint="shoulder" kp="20" kv="1"/>
    <position name="m2" joint="elbow" kp="20" kv="1"/>
    <position name="m3" joint="wrist" kp="5" kv=".2"/>
  </actuator>
</mujoco>
"""


def arm(tmp_path: Path, xml: str = ARM) -> LoadedModel:
    file = tmp_path / "model.xml"
    file.write_text(xml)
    return load_model(file)


def motion(rows: int = 300, rate: float = 50.0) -> tuple[Array, Array, Array]:
    """Times, positions (each joint its own sine and place), commands a row ahead."""
    time = np.arange(rows) / rate
    place = np.array([0.3, -1.0, 0.5])
    swing = np.array([0.8, 0.9, 1.1])
    speed = np.array([2.0, 3.1, 4.3])
    ahead = time[:, None] + 1 / rate
    position = place + swing * np.sin(speed * time[:, None])
    return time, position, place + swing * np.sin(speed * ahead)


def write_csv(file: Path, columns: Mapping[str, Array]) -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{x:.9g}" for x in row) for row in rows)]
    file.write_text("\n".join(lines))
    return file


def arm_columns(
    time: Array, position: Array, command: Array | None = None
) -> dict[str, Array]:
    columns = {"time": time}
    columns |= {name: position[:, i] for i, name in enumerate(JOINTS)}
    if command is not None:
        columns |= {f"cmd_{name}": command[:, i] for i, name in enumerate(JOINTS)}
    return columns


def write_arm(file: Path, **changes: Array) -> Path:
    """Write the motion as CSV, some columns (or the time) put in place of its own."""
    return write_csv(file, {**arm_columns(*motion()), **changes})


def write_lerobot(
    folder: Path,
    features: Mapping[str, tuple[Sequence[str] | None, Sequence[Array]]],
    fps: int = 50,
    listed: int | None = None,
) -> Path:
    """Write a v2.1 folder: ``{feature: (names, one array (T, n) an episode)}``."""
    episodes = len(next(iter(features.values()))[1])
    lengths = [len(part) for part in next(iter(features.values()))[1]]
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    told = {
        key: {"dtype": "float32", "shape": [parts[0].shape[1]], "names": names}
        for key, (names, parts) in features.items()
    }
    told["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    total = listed or episodes
    info = {"codebase_version": "v2.1", "fps": fps, "features": told}
    info |= {"total_episodes": total}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    rows = [
        {"episode_index": i, "length": lengths[min(i, episodes - 1)]}
        for i in range(total)
    ]
    text = "\n".join(json.dumps(row) for row in rows)
    (folder / "meta" / "episodes.jsonl").write_text(text)
    task = {"task_index": 0, "task": "move"}
    (folder / "meta" / "tasks.jsonl").write_text(json.dumps(task))
    for index, length in enumerate(lengths):
        table = {
            key: pa.array(parts[index].astype(np.float32).tolist())
            for key, (_, parts) in features.items()
        }
        table["timestamp"] = pa.array((np.arange(length) / fps).astype(np.float32))
        table["frame_index"] = pa.array(np.arange(length))
        table["episode_index"] = pa.array(np.full(length, index))
        file = folder / "data" / "chunk-000" / f"episode_{index:06d}.parquet"
        pq.write_table(pa.table(table), file)
    return folder
