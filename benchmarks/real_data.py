"""The measured data sets, their models, and what was known of them beforehand."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs import read_log
from rlco.gap.logs.log import Log, Recording
from rlco.gap.model import LoadedModel, load_model

FOLDER = Path(__file__).parents[2] / "shared" / "data" / "real"
# The data's unit of length is half a cube's width [m].
HALF = 0.0524
CUBE_PERIOD = 1.0 / 148.0

STIFFNESS = 50.0  # of a servo of the G1's arm, roughly [N m/rad]
# What was measured, the number, its target, and what was known before.
Row = tuple[str, str, str, str]


def present(name: str) -> bool:
    """Return whether a data set lies where it is read from; say so if not."""
    there = (FOLDER / name).is_dir()
    if not there:
        print(f"{name}: not found in {FOLDER}, skipped.")
    return there


def servo() -> tuple[LoadedModel, Log]:
    """Return the XL330 as it was published, and its 16 runs on a pendulum."""
    loaded = load_model("bam:xl330")
    return loaded, read_log(FOLDER / "bam_xl330" / "raw_xl330", loaded)


def cube(tosses: Sequence[int]) -> Log:
    """Return some of the tosses, in metres.

    The logged velocities are backward differences, half a row late: those that the
    poses of the first tenth of a second tell are better.
    """
    stored = np.load(FOLDER / "cube_tosses" / "cube_tosses.npz")
    ends = np.cumsum(stored["length"])
    recordings = []
    for toss in tosses:
        rows = stored["data"][ends[toss] - stored["length"][toss] : ends[toss]]
        pose = rows[:, :7].astype(float)
        pose[:, :3] *= HALF
        time = CUBE_PERIOD * np.arange(len(rows))
        recordings.append(Recording(f"toss {toss}", time, pose=pose))
    return Log(tuple(recordings), body="cube")


def cube_model() -> mujoco.MjSpec:
    """Return an acrylic cube above a board, with MuJoCo's default contacts."""
    return mujoco.MjSpec.from_string(f"""
        <mujoco>
          <option timestep="0.002" cone="elliptic"/>
          <worldbody>
            <geom name="board" type="plane" size="2 2 0.1"/>
            <body name="cube" pos="0 0 0.1">
              <freejoint/>
              <geom name="cube" type="box" size="{HALF} {HALF} {HALF}" mass="0.37"/>
            </body>
          </worldbody>
        </mujoco>""")


def panda() -> tuple[LoadedModel, Log]:
    """Return robosuite's Panda as a rigid body, and the real one's torques."""
    found = importlib.util.find_spec("robosuite")
    assets = Path(str(found and found.origin)).parent / "models/assets/robots/panda"
    loaded = load_model(assets / "robot.xml")
    for joint in loaded.spec.joints:
        joint.frictionloss, joint.armature = 0.0, 0.0
        joint.damping = np.zeros_like(joint.damping)
    loaded = replace(loaded, model=loaded.spec.copy().compile())
    return loaded, read_log(FOLDER / "panda_ur10_unisa" / "panda.csv", loaded)


@functools.cache
def _g1() -> Log:
    return read_log(FOLDER / "lerobot_g1")


def g1_right_arm() -> tuple[str, ...]:
    """Return the joints of the arm that picked the bottles."""
    right = (name for name in _g1().joints if name.startswith("kRight"))
    return tuple(name for name in right if "Hand" not in name)


def g1_servo(joint: str, bandwidth: float) -> tuple[mujoco.MjSpec, Log]:
    """Return one joint of the G1 as a servo that carries nothing, and its log.

    The robot's gains are not known, nor what the joint carries: the servo has a
    stiffness as such arms have, is critically damped, and follows a ramp late by
    2 / bandwidth.

    Args:
        joint: Its name.
        bandwidth: Natural frequency of the servo [rad/s].
    """
    inertia = " ".join([f"{STIFFNESS / bandwidth**2}"] * 3)
    spec = mujoco.MjSpec.from_string(f"""
        <mujoco>
          <option timestep="0.0033333333" integrator="implicitfast" gravity="0 0 0"/>
          <worldbody>
            <body name="{joint}">
              <joint name="{joint}" axis="0 0 1"/>
              <inertial mass="1" pos="0 0 0" diaginertia="{inertia}"/>
            </body>
          </worldbody>
          <actuator>
            <position name="{joint}" joint="{joint}" kp="{STIFFNESS}"
                      kv="{2.0 * STIFFNESS / bandwidth}"/>
          </actuator>
        </mujoco>""")
    log = _g1()
    column = [log.joints.index(joint)]
    recordings = tuple(
        replace(
            one,
            position=np.asarray(one.position)[:, column],
            command=np.asarray(one.command)[:, column],
        )
        for one in log.recordings
    )
    return spec, Log(recordings, (joint,), (joint,))


def said(verdict: Verdict) -> str:
    """Return a verdict as a sentence: what was named, with numbers and rivals."""
    parts = []
    for one in verdict.effects:
        name, value = next(iter(one.parameters.items()))
        part = f"{one.name} {one.target or ''}".strip()
        part += f" ({name} {value.value:.3g} [{value.low:.3g}, {value.high:.3g}])"
        rivals = [f"{rival.name} {rival.target or ''}".strip() for rival in one.rivals]
        parts.append(part + (f" or {', '.join(rivals)}" if rivals else ""))
    return f"{verdict.verdict}: {'; '.join(parts) or 'nothing'}"
