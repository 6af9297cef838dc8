"""A small arm, a motion of it, and the same log written in several formats."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from rlco.gap.logs.log import Array
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
    version: str = "v2.1",
) -> Path:
    """Write a folder: ``{feature: (names, one array (T, n) an episode)}``.

    Each episode has a file of its own, in v3, too, so that some can be lacking.
    """
    lengths = [len(part) for part in next(iter(features.values()))[1]]
    total = listed or len(lengths)
    data = folder / "data" / "chunk-000"
    (folder / "meta").mkdir(parents=True)
    data.mkdir(parents=True)
    told = {
        key: {"dtype": "float32", "shape": [parts[0].shape[1]], "names": names}
        for key, (names, parts) in features.items()
    }
    told["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    info = {"codebase_version": version, "fps": fps, "features": told}
    info |= {"total_episodes": total}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    rows = [
        {"episode_index": i, "length": lengths[min(i, len(lengths) - 1)]}
        for i in range(total)
    ]
    _write_lists(folder / "meta", rows, version)
    stem = "episode_{:06d}" if version == "v2.1" else "file-{:03d}"
    for index, length in enumerate(lengths):
        table = {
            key: pa.array(parts[index].astype(np.float32).tolist())
            for key, (_, parts) in features.items()
        }
        table["timestamp"] = pa.array((np.arange(length) / fps).astype(np.float32))
        table["frame_index"] = pa.array(np.arange(length))
        table["episode_index"] = pa.array(np.full(length, index))
        pq.write_table(pa.table(table), data / f"{stem.format(index)}.parquet")
    return folder


def _write_lists(meta: Path, rows: list[dict[str, int]], version: str) -> None:
    """Write the lists of episodes and tasks, which the versions keep differently."""
    task = {"task_index": 0, "task": "move"}
    if version == "v2.1":
        text = "\n".join(json.dumps(row) for row in rows)
        (meta / "episodes.jsonl").write_text(text)
        (meta / "tasks.jsonl").write_text(json.dumps(task))
        return
    (meta / "episodes" / "chunk-000").mkdir(parents=True)
    places = [
        row | {"data/chunk_index": 0, "data/file_index": row["episode_index"]}
        for row in rows
    ]
    file = meta / "episodes" / "chunk-000" / "file-000.parquet"
    pq.write_table(pa.Table.from_pylist(places), file)
    pq.write_table(pa.Table.from_pylist([task]), meta / "tasks.parquet")


def urdf(grip: str = "fixed") -> str:
    """Two links and a tool that is gripped by a joint of a kind."""
    links = "".join(
        f"<link name='{name}'><inertial><origin xyz='.1 0 .02'/><mass value='{mass}'/>"
        "<inertia ixx='.01' iyy='.01' izz='.01' ixy='0' ixz='0' iyz='0'/></inertial>"
        "<visual><geometry><sphere radius='.05'/></geometry></visual></link>"
        for name, mass in (("upper", 1.0), ("lower", 0.5), ("tool", 0.3))
    )
    joints = "".join(
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child "
        f"link='{child}'/><origin xyz='{place} 0 0'/><axis xyz='0 1 0'/><limit "
        "lower='-2' upper='2' effort='20' velocity='5'/></joint>"
        for name, kind, parent, child, place in (
            ("shoulder", "revolute", "base", "upper", 0.0),
            ("elbow", "revolute", "upper", "lower", 0.2),
            ("grip", grip, "lower", "tool", 0.2),
        )
    )
    return f"<robot name='arm'><link name='base'/>{links}{joints}</robot>"
