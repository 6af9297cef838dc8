"""Small whole files of every kind that rlco reads, and how it reads them."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np
import PIL.Image
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from rlco.gap.logs import read_log
from rlco.gap.model import load_model
from rlco.lerobot_files import iterate_images, read_columns, read_folder
from rlco.physics.spec.domain import STAND_IN, read_domain, write_domain
from rlco.policies import load_policy, make_policy, save_policy
from rlco.reporting.experiments.comparison import comparison_table, cost_table
from rlco.reporting.experiments.results import made_by, table_entries
from rlco.reporting.paired_results import read_evaluation
from rlco.reporting.report import write_report
from rlco.reporting.statistics import ResultRow
from rlco.run import Run
from rlco.runs.compare.cells import Cell, Store
from rlco.runs.compare.jobs import expand
from rlco.runs.compare.reading.read_experiment import read_experiment
from rlco.runs.config import RunOptions, parse, to_yaml
from rlco.runs.state_files import load_state, save_state

ROWS, RATE = 160, 20
MJCF = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 0"
size=".02"/><body name="lower" pos=".2 0 0"><joint name="elbow" axis="0 1 0"/>
<geom size=".03" mass="0.5"/></body></body></worldbody><actuator>
<position name="m1" joint="shoulder" kp="20"/></actuator></mujoco>"""
URDF = """<robot name="arm"><link name="base"/><link name="upper"><inertial>
<mass value="1"/><origin xyz="0.1 0 0"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1"
iyz="0" izz="0.1"/></inertial></link><joint name="shoulder" type="revolute">
<parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
EVAL_INFO = {
    "per_task": [{"task_group": "a", "task_id": 0, "metrics": {"successes": [1, 0]}}]
}
EXPERIMENT = """name: two
over: {seed: [0, 1], beta: [0, 0.2]}
without: [{seed: 1, beta: 0}]
jobs:
  one:
    script: recipes/sft.py
    minutes: 2
    options: {eval_domains: [sim], seed: "{seed}"}
  two:
    script: recipes/rl_co.py
    options: {policy: "{one}/policy", real_coeff: "{beta}", seed: "{seed}"}
table:
  methods:
    sft: {job: one, method: sft}
    beta {beta}: {job: two, curve: metrics.csv}
  differences: [[beta 0.2, sft]]
"""


@dataclass(frozen=True)
class Reader:
    """One kind of files.

    Attributes:
        write: Writes whole ones into an empty folder.
        read: Reads them from there.
    """

    write: Callable[[Path], Any]
    read: Callable[[Path], Any]


def columns() -> dict[str, np.ndarray]:
    time = np.arange(ROWS) / RATE
    names = ("shoulder", "elbow")
    position = {f"{n}_position": np.sin(time + i) for i, n in enumerate(names)}
    return {"time": time, **position, "command_m1": np.sin(time + 0.05)}


def write_csv(folder: Path) -> None:
    named = columns()
    lines = [
        ",".join(f"{v:.5f}" for v in row) for row in zip(*named.values(), strict=True)
    ]
    (folder / "log.csv").write_text("\n".join([",".join(named), *lines]))


def write_npz(folder: Path) -> None:
    np.savez_compressed(folder / "log.npz", **columns(), lengths=[ROWS // 2, ROWS // 2])


def write_bam(folder: Path) -> None:
    time = np.arange(ROWS) / RATE
    entries = [
        {"timestamp": t, "position": np.sin(t), "speed": 0.0, "goal_position": 0.1}
        for t in time.tolist()
    ]
    content = {"mass": 0.5, "length": 0.1, "kp": 8, "vin": 5.0, "motor": "xl330"}
    (folder / "log.json").write_text(json.dumps({**content, "entries": entries}))


def write_bag(folder: Path, store: StoragePlugin) -> None:
    types = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    none = np.zeros(0)
    with Writer(folder / "bag", version=9, storage_plugin=store) as bag:
        topic = bag.add_connection("/joint_states", kind, typestore=types)
        for row in range(ROWS):
            stamp = types.types["builtin_interfaces/msg/Time"](
                row // RATE, row % RATE * 10**9 // RATE
            )
            header = types.types["std_msgs/msg/Header"](stamp, "base")
            names, place = ["shoulder", "elbow"], np.sin([row / RATE, row / RATE + 1])
            message = types.types[kind](header, names, place, none, none)
            at = int(1e9 * row / RATE)
            bag.write(topic, at, types.serialize_cdr(message, kind))


def frames(episode: int, length: int, *, film: bool) -> pa.Table:
    image = io.BytesIO()
    PIL.Image.new("RGB", (32, 16), (episode, 9, 9)).save(image, "PNG")
    table = {
        "observation.state": pa.array(np.ones((length, 2)).tolist()),
        "action": pa.array(np.zeros((length, 2)).tolist(), pa.list_(pa.float32())),
        "timestamp": pa.array(np.arange(length) / RATE, pa.float32()),
        "frame_index": pa.array(np.arange(length)),
        "episode_index": pa.array(np.full(length, episode)),
        "task_index": pa.array(np.zeros(length, np.int64)),
    }
    if not film:
        table["camera"] = pa.array([{"bytes": image.getvalue(), "path": None}] * length)
    return pa.table(table)


def put(file: Path, table: pa.Table) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, file)


def info(version: str, *, film: bool) -> str:
    kinds = {"observation.state": "float64", "action": "float32"}
    numbers = {
        n: {"dtype": t, "shape": [2], "names": ["a", "b"]} for n, t in kinds.items()
    }
    single = {
        n: {"dtype": "int64", "shape": [1]} for n in ("frame_index", "task_index")
    }
    stamp = {"timestamp": {"dtype": "float32", "shape": [1]}}
    camera = {"dtype": "video" if film else "image", "shape": [16, 32, 3]}
    features = {**numbers, **single, **stamp, "camera": camera}
    about = {"codebase_version": version, "fps": RATE, "total_episodes": 2}
    return json.dumps({**about, "chunks_size": 1000, "features": features})


def write_v2(folder: Path) -> None:
    (folder / "meta").mkdir()
    (folder / "meta/info.json").write_text(info("v2.1", film=True))
    (folder / "meta/tasks.jsonl").write_text('{"task_index": 0, "task": "push"}\n')
    listed = [json.dumps({"episode_index": i, "length": 4}) for i in range(2)]
    (folder / "meta/episodes.jsonl").write_text("\n".join(listed))
    for i in range(2):
        name = f"chunk-000/{{}}episode_{i:06d}"
        put(folder / "data" / f"{name.format('')}.parquet", frames(i, 4, film=True))
        film = folder / "videos" / f"{name.format('camera/')}.mp4"
        film.parent.mkdir(parents=True, exist_ok=True)
        with av.open(str(film), "w") as container:
            stream = container.add_stream("mpeg4", rate=RATE)
            stream.width, stream.height, stream.pix_fmt = 32, 16, "yuv420p"
            pixels = np.zeros((16, 32, 3), np.uint8)
            for _ in range(4):
                shown = av.VideoFrame.from_ndarray(pixels, "rgb24")
                container.mux(stream.encode(shown))
            container.mux(stream.encode(None))


def write_v3(folder: Path) -> None:
    (folder / "meta").mkdir()
    (folder / "meta/info.json").write_text(info("v3.0", film=False))
    put(folder / "meta/tasks.parquet", pa.table({"task_index": [0], "task": ["push"]}))
    episodes = {
        "episode_index": [0, 1],
        "length": [4, 4],
        "data/chunk_index": [0, 0],
        "data/file_index": [0, 0],
    }
    put(folder / "meta/episodes/chunk-000/file-000.parquet", pa.table(episodes))
    both = pa.concat_tables([frames(i, 4, film=False) for i in range(2)])
    put(folder / "data/chunk-000/file-000.parquet", both)


def read_lerobot(folder: Path) -> None:
    found = read_folder(folder)
    numbers = [n for n, f in found.features.items() if f.dtype.startswith(("f", "i"))]
    read_columns(found, [n for n in numbers if not found.features[n].is_camera])
    for camera in found.cameras:
        for images in iterate_images(found, camera):
            images.sum()


def write_state(folder: Path) -> None:
    state = {"w": torch.arange(64.0), "names": ["a", "b"], "lr": 0.5, "n": (1, None)}
    save_state(folder / "state.safetensors", state)


def write_policy(folder: Path) -> None:
    policy = make_policy("gaussian", state_size=3, chunk=2, hidden=[8])
    save_policy(policy, folder, extra={"task": "push_cube"})


def result(method: str) -> ResultRow:
    return ResultRow(
        method=method,
        domain="sim",
        task="push_cube",
        policy="gaussian",
        variation=None,
        seed=0,
        episodes=8,
        successes=5,
    )


def write_run(folder: Path) -> None:
    with Run(RunOptions(out=str(folder / "run")), "demo") as run:
        for step in (1, 2):
            run.log_metrics(step, {"loss": 1 / step, "success": 0.5})
            run.save_checkpoint(step, {"weight": torch.arange(8.0)})
        run.save_results([result("sft")])
    for left in (folder / "run/tb").glob("*"):
        left.unlink()  # written anew, never read


def write_experiment(folder: Path) -> None:
    file = folder / "two.yaml"
    file.write_text(EXPERIMENT)
    (folder / "cells").mkdir()
    for job in expand(read_experiment(file)):
        row = dict(result("sft" if job.kind.name == "one" else "rl_co"))
        curve = [{"step": 1.0, "success_sim": 0.5}, {"step": 2.0, "success_sim": 0.75}]
        about = {"name": job.name, "key": job.key, "identity": job.identity}
        made = {"code": job.code.version, "script": job.kind.script, "options": {}}
        cell = Cell(**about, **made, rows=[row], curves={"metrics.csv": curve})
        cell.write(folder / "cells" / f"{job.folder}.json")


def read_tables(folder: Path) -> None:
    experiment = read_experiment(folder / "two.yaml")
    jobs, store = expand(experiment), Store(folder / "out", folder / "cells", "any")
    entries = table_entries(experiment, jobs, store)
    comparison_table(entries, experiment.table.differences)
    cost_table(entries)
    made_by(jobs, store)


def resume(folder: Path) -> None:
    config = parse(RunOptions, [f"resume={folder / 'run'}"], "demo.py")
    with Run(config, "demo") as run:
        run.load_checkpoint()
        for step in run.iterations(3):
            run.log_metrics(step, {"loss": 1 / step})


@cache
def arm() -> Any:
    from tempfile import mkdtemp

    file = Path(mkdtemp()) / "arm.xml"
    file.write_text(MJCF)
    return load_model(file)


def of_text(name: str, text: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / name).write_text(text)

    return write


READERS = {
    "LeRobot v2.1": Reader(write_v2, read_lerobot),
    "LeRobot v3": Reader(write_v3, read_lerobot),
    "CSV": Reader(write_csv, lambda f: read_log(f / "log.csv", arm())),
    "NPZ": Reader(write_npz, lambda f: read_log(f / "log.npz", arm())),
    "BAM JSON": Reader(write_bam, lambda f: read_log(f / "log.json")),
    "rosbag2 MCAP": Reader(
        lambda f: write_bag(f, StoragePlugin.MCAP), lambda f: read_log(f / "bag", arm())
    ),
    "rosbag2 SQLite": Reader(
        lambda f: write_bag(f, StoragePlugin.SQLITE3),
        lambda f: read_log(f / "bag", arm()),
    ),
    "YAML": Reader(
        of_text("c.yaml", to_yaml(RunOptions(seed=3))),
        lambda f: parse(RunOptions, [f"config={f / 'c.yaml'}"], "demo.py"),
    ),
    "effects": Reader(
        lambda f: write_domain(f / "robot.yaml", STAND_IN),
        lambda f: read_domain(f / "robot.yaml"),
    ),
    "MJCF": Reader(of_text("arm.xml", MJCF), lambda f: load_model(f / "arm.xml")),
    "URDF": Reader(of_text("arm.urdf", URDF), lambda f: load_model(f / "arm.urdf")),
    "checkpoint": Reader(write_state, lambda f: load_state(f / "state.safetensors")),
    "policy": Reader(write_policy, load_policy),
    "results.json": Reader(write_run, lambda f: write_report(f / "run")),
    "resume=": Reader(write_run, resume),
    "eval_info.json": Reader(
        of_text("eval_info.json", json.dumps(EVAL_INFO)), read_evaluation
    ),
    "experiment": Reader(write_experiment, read_tables),
}
