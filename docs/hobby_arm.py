"""A simulated arm of the SO-101's sizes, and a LeRobot data set of it: no robot moved.

    uv run python docs/hobby_arm.py hobby_arm

It writes ``arm.xml``, the model as its owner has it, and ``recordings``, a LeRobot data
set as a leader arm would record it. The arm in the recordings differs from the model in
two things, which ``find_gap`` is to find.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

JOINTS = (
    "shoulder_pan",
    "shoulder_lift",
    "elbow_flex",
    "wrist_flex",
    "wrist_roll",
    "gripper",
)
# BAM's class m1 of Feetech's STS3215 at 7.4 V: torque per ampere [N m/A], resistance
# [ohm], inertia [kg m^2], friction [N m] and damping [N m s/rad]. Its firmware gives
# 0.166 * 1.005 of the voltage per radian of error and unit of P, and at most 0.97 of
# it; LeRobot sets P to 16. Its speed limit, 5.3 rad/s, no motion here reaches.
TORQUE, OHM, VOLTS, INERTIA = 1.178, 2.479, 7.4, 0.0261
FRICTION, DAMPING = 0.0515, 0.0599 + TORQUE**2 / OHM
STALL = TORQUE * VOLTS / OHM
GAIN, LIMIT = STALL * 0.166 * 1.005 * 16, STALL * 0.97
# From each joint to the next: axis, length [m], mass [kg], range [degrees].
LINKS = (
    ("0 0 1", (0.03, 0.0, 0.055), 0.12, 110),
    ("0 1 0", (0.03, 0.0, 0.11), 0.11, 100),
    ("0 1 0", (0.135, 0.0, 0.0), 0.10, 97),
    ("0 1 0", (0.06, 0.0, 0.0), 0.08, 95),
    ("1 0 0", (0.06, 0.0, 0.0), 0.09, 160),
    ("0 0 1", (0.07, 0.02, 0.0), 0.02, 110),
)
FPS, STEPS = 30, 500  # frames and physics steps per second
SECONDS, EPISODES = 8.0, 6
COUNTS = 4096  # of an encoder, per turn
OPEN = 110.0  # degrees of the gripper that LeRobot calls 100


def arm_xml(real: bool = False) -> str:
    """Return the arm's model as its owner has it; real: as it is.

    The owner's has no joint for the gripper's jaw, which LeRobot reports from 0 to 100.
    """
    bodies, ends, moving = "", "", JOINTS if real else JOINTS[:-1]
    for joint, (axis, (x, y, z), mass, degrees) in zip(JOINTS, LINKS, strict=True):
        low = 0 if joint == "gripper" else -degrees
        friction = FRICTION + 0.15 * (real and joint == "elbow_flex")
        camera = "<geom size='.015' pos='.02 0 .05' mass='.12'/>"
        shape = f'<geom type="capsule" size=".016" fromto="0 0 0 {x} {y} {z}" '
        shape += f'mass="{mass}"/>'
        if joint not in moving:  # a part of the link before it
            bodies += f'<frame pos="{last(joint)}">{shape}</frame>'
            continue
        bodies += f"""
        <body name="{joint}_link" pos="{last(joint)}">
        <joint name="{joint}" axis="{axis}" range="{low} {degrees}" damping="{DAMPING}"
        frictionloss="{friction}" armature="{INERTIA}"/>
        {shape}{camera if real and joint == "wrist_roll" else ""}"""
        ends += "</body>"
    servos = "".join(
        f'<position name="{joint}" joint="{joint}" kp="{GAIN}" '
        f'forcerange="{-LIMIT} {LIMIT}"/>'
        for joint in moving
    )
    return f"""<mujoco model="hobby_arm"><option timestep="{1 / STEPS}"/>
    <default><geom contype="0" conaffinity="0"/></default>
    <worldbody>
    <geom type="box" size=".04 .04 .03" pos="0 0 .03"/>{bodies}{ends}</worldbody>
    <actuator>{servos}</actuator></mujoco>"""


def last(joint: str) -> str:
    """Return where a joint is in the link before it."""
    number = JOINTS.index(joint)
    place = (0.0, 0.0, 0.06) if number == 0 else LINKS[number - 1][1]
    return " ".join(map(str, place))


def reaches(random: np.random.Generator, seconds: float) -> np.ndarray:
    """Return the goals of a person's reaches, slow and quick, (frames, 6) [degrees].

    They are whole counts of an encoder, as the leader reads and the servos receive.
    """
    frames, at = round(seconds * FPS), np.array([0.0, -50.0, 50.0, 20.0, 0.0, 30.0])
    middle, spread = at.copy(), np.array([50.0, 35.0, 35.0, 40.0, 60.0, 25.0])
    rows = []
    while len(rows) < frames:
        goal = middle + spread * random.uniform(-1.0, 1.0, 6)
        steps = round(FPS * random.uniform(0.8, 2.0))
        part = np.arange(1, steps + 1) / steps
        smooth = 10 * part**3 - 15 * part**4 + 6 * part**5  # least jerk
        rows += list(at + smooth[:, None] * (goal - at))
        rows += [goal] * round(FPS * random.uniform(0.0, 0.6))
        at = goal
    return np.round(np.array(rows[:frames]) * COUNTS / 360) * 360 / COUNTS


def played(model: mujoco.MjModel, goals: np.ndarray) -> np.ndarray:
    """Return the angles that the encoders report at each frame, (frames, 6) [rad]."""
    data, period = mujoco.MjData(model), STEPS / FPS
    data.qpos[:] = data.ctrl[:] = np.deg2rad(goals[0])
    for _ in range(STEPS):  # it rests before it is recorded
        mujoco.mj_step(model, data)
    rows, done = [], 0
    for frame, goal in enumerate(goals):
        while done < round(frame * period):
            mujoco.mj_step(model, data)
            done += 1
        rows.append(data.qpos.copy())
        data.ctrl[:] = np.deg2rad(goal)
    counts = np.round(np.array(rows) * COUNTS / (2 * np.pi))
    return counts * 2 * np.pi / COUNTS


def as_lerobot(degrees: np.ndarray) -> pa.Array:
    """Return angles as LeRobot writes them: degrees, but the gripper from 0 to 100."""
    shown = degrees.astype(np.float32)
    shown[:, -1] *= 100.0 / OPEN
    return pa.array(shown.tolist(), pa.list_(pa.float32()))


def write(folder: Path, episodes: int = EPISODES, seconds: float = SECONDS) -> None:
    """Write the model and the data set (LeRobot v2.1) into a new folder."""
    folder.mkdir(parents=True)
    (folder / "arm.xml").write_text(arm_xml())
    chunk, meta = folder / "recordings/data/chunk-000", folder / "recordings/meta"
    chunk.mkdir(parents=True)
    meta.mkdir()
    names = [f"{joint}.pos" for joint in JOINTS]
    feature = {"dtype": "float32", "shape": [6], "names": names}
    number = {"dtype": "int64", "shape": [1], "names": None}
    features = {"observation.state": feature, "action": feature}
    features |= {"frame_index": number, "episode_index": number}
    features |= {"timestamp": {**number, "dtype": "float32"}}
    info = {"codebase_version": "v2.1", "fps": FPS, "features": features}
    (meta / "info.json").write_text(json.dumps(info | {"total_episodes": episodes}))
    model = mujoco.MjModel.from_xml_string(arm_xml(real=True))
    random, lines = np.random.default_rng(0), []
    for episode in range(episodes):
        goals = reaches(random, seconds)
        columns = {
            "observation.state": as_lerobot(np.rad2deg(played(model, goals))),
            "action": as_lerobot(goals),
            "timestamp": pa.array(np.arange(len(goals)) / FPS, pa.float32()),
            "frame_index": pa.array(range(len(goals))),
            "episode_index": pa.array([episode] * len(goals)),
        }
        pq.write_table(pa.table(columns), chunk / f"episode_{episode:06d}.parquet")
        lines.append(json.dumps({"episode_index": episode, "length": len(goals)}))
    (meta / "episodes.jsonl").write_text("\n".join(lines) + "\n")
    (meta / "tasks.jsonl").write_text('{"task_index": 0, "task": "reach"}\n')


if __name__ == "__main__":
    write(Path(sys.argv[1]))
