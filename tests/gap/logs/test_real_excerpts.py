"""Excerpts of measured logs: what was measured on real hardware comes out of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import robosuite
from numpy.typing import NDArray

from rlco.gap.compare.free_body import FreeBody
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs import read_log
from rlco.gap.logs.log import Log, Recording
from rlco.gap.prune import prune
from rlco.physics.effects import AppliedEffect

EXCERPTS = Path(__file__).parents[2] / "real_excerpts"
HALF_CUBE = 0.0524  # the tosses' unit of length [m]
CUBE = f"""<mujoco><option timestep="0.002" cone="elliptic"/><worldbody>
<geom type="plane" size="2 2 .1"/><body name="cube" pos="0 0 .1"><freejoint/>
<geom type="box" size="{HALF_CUBE} {HALF_CUBE} {HALF_CUBE}" mass=".37"/></body>
</worldbody></mujoco>"""


def tosses() -> Log:
    """Return the three tosses in metres."""
    stored = np.load(EXCERPTS / "cube_tosses.npz")
    parts = np.split(stored["data"].astype(float), np.cumsum(stored["length"])[:-1])
    time = np.arange(len(parts[0])) / 148.0
    poses = [part[:, :7] * ([HALF_CUBE] * 3 + [1.0] * 4) for part in parts]
    return Log(
        tuple(Recording(f"toss {i}", time, pose=p) for i, p in enumerate(poses)),
        body="cube",
    )


def panda() -> tuple[mujoco.MjSpec, Log]:
    """Return robosuite's Panda without friction, and what the real one measured."""
    xml = Path(robosuite.__file__).parent / "models/assets/robots/panda/robot.xml"
    spec = mujoco.MjSpec.from_file(str(xml))
    for joint in spec.joints:
        joint.frictionloss = joint.armature = 0.0
        joint.damping = np.zeros_like(np.array(joint.damping))
    log = read_log(EXCERPTS / "panda.csv")
    return prune(spec), replace(log, joints=tuple(f"joint{i}" for i in range(1, 8)))


def rms(rows: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(rows**2)))


def test_a_real_cube_falls_freely_and_slides_as_far_as_its_published_friction() -> None:
    log = tosses()
    falls = [
        2 * np.polyfit(part.time[:12], part.pose[:12, 2], 2)[0]
        for part in log.recordings
    ]
    assert np.mean(falls) == pytest.approx(-9.81, rel=0.05)
    published = AppliedEffect("contact_friction", None, {"friction": 0.18})
    problem = FreeBody(mujoco.MjSpec.from_string(CUBE), log)
    nominal, right = problem.residuals([Hypothesis(), Hypothesis((published,))])
    # Of 95 tosses the mean error falls from 7.7 cm to 1.1 cm.
    assert rms(right) < rms(nominal) / 3


def test_a_real_pandas_wrist_shows_coulomb_friction() -> None:
    problem = TorqueLog(*panda())
    friction = tuple(
        AppliedEffect("coulomb_friction", joint, {"frictionloss": size})
        for joint, size in (("joint6", 0.26), ("joint7", 0.25))
    )
    rows = problem.residuals([Hypothesis(), Hypothesis(friction)])
    for joint, before, after in ((5, 0.35, 0.20), (6, 0.29, 0.09)):  # N m, 24 s of it
        sizes = [rms(row[problem.layout.channel == joint]) for row in rows]
        np.testing.assert_allclose(sizes, [before, after], atol=0.06)


def test_a_real_servo_falls_from_the_moment_its_torque_is_off() -> None:
    (run,) = read_log(EXCERPTS / "xl330_lift_and_drop.json").recordings
    assert (run.facts["kp"], run.facts["mass"]) == (400, 0.49)
    off = run.extra["torque_enable"] < 0.5
    assert run.time[off][0] == pytest.approx(2.0, abs=0.02)
    angle = run.position[:, 0]  # 0 hangs down
    held, fallen = angle[~off][-1], angle[off]
    assert held < -0.5
    # It swings through and, with what friction leaves of its height, up again.
    top = fallen.max()
    assert 0.3 * abs(held) < top < abs(held)
    # Then it stays where friction holds it, near below.
    assert np.abs(fallen[-20:]).max() < 0.3 * abs(held)


def test_a_real_humanoids_arm_is_four_to_five_frames_behind_its_command() -> None:
    log = read_log(EXCERPTS / "lerobot_g1")
    (part,) = log.recordings
    assert part.time[1] - part.time[0] == pytest.approx(1 / 30)
    moving = np.argsort(-part.command[:, 7:14].std(axis=0))[:3] + 7  # of the right arm
    lags = []
    for joint in moving:
        sent, seen = part.command[:, joint], part.position[:, joint]
        match = [np.corrcoef(sent[: -k or None], seen[k:])[0, 1] for k in range(12)]
        lags.append(int(np.argmax(match)))
    assert np.median(lags) in (4, 5)  # 130 to 170 ms
