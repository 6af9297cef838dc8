"""Measured logs and the public cases, read as their sources describe them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from log_cases import SHARED, arm

from rlco.gap.logs import read_log
from rlco.gap.model import load_model

CASES = sorted((SHARED / "gap_cases").glob("pub_*"))
REAL = SHARED / "real"
pytestmark = pytest.mark.skipif(
    not (REAL.is_dir() and CASES), reason=f"{SHARED} is not there, or not whole"
)
PIN = """<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -.1" mass=".49" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="2"/></actuator></mujoco>"""
CUBE = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="cube">
<freejoint/><geom type="box" size=".0524 .0524 .0524" mass=".37"/></body></worldbody>
</mujoco>"""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_public_cases_read_without_a_remark(case: Path) -> None:
    model = load_model(case / "model.xml")
    log = read_log(case / "data", model)
    assert log.notes == ()
    assert log.joints == model.joints
    assert log.actuators == model.actuators
    assert len(log.recordings) == (8 if "hard" in case.name else 10)
    for part in log.recordings:
        np.testing.assert_allclose(part.time, np.arange(300) * 0.02, atol=1e-12)
        assert (part.velocity is None) == ("hard" in case.name)


def test_humanoid_arms_without_a_model() -> None:
    log = read_log(REAL / "lerobot_g1")
    assert len(log.recordings) == 20
    assert len(log.joints) == len(log.actuators) == 26
    assert log.joints[:2] == ("kLeftShoulderPitch", "kLeftShoulderRoll")
    assert log.notes == ("Of 100 listed episodes 80 have no file.",)
    time = log.recordings[0].time
    np.testing.assert_allclose(np.diff(time), 1 / 30, atol=1e-9)


def test_a_rosbag_is_its_decoded_table() -> None:
    folder = REAL / "panda_ur10_unisa"
    bag = read_log(folder / "panda_exciting_trajectory.db3").recordings[0]
    table = read_log(folder / "panda.csv").recordings[0]
    for channel in ("time", "position", "velocity", "torque"):
        # The table has nine digits.
        np.testing.assert_allclose(
            getattr(bag, channel), getattr(table, channel), rtol=1e-8, atol=1e-7
        )


def test_servo_runs_keep_their_bench(tmp_path: Path) -> None:
    log = read_log(REAL / "bam_xl330" / "raw_xl330", arm(tmp_path, PIN))
    assert (log.joints, log.actuators) == (("hinge",), ("servo",))
    gains = [part.facts["kp"] for part in log.recordings]
    assert sorted(gains) == sorted([100, 200, 400, 800] * 4)
    assert {part.facts["mass"] for part in log.recordings} == {0.49}
    # Off from the second second on where the pendulum is let fall.
    falls = [part for part in log.recordings if "drop" in part.name]
    assert len(falls) == 4
    for part in falls:
        off = part.time[part.extra["torque_enable"] < 0.5]
        assert off[0] == pytest.approx(2.0, abs=0.02)
    loads = np.concatenate([part.extra["load"] for part in log.recordings])
    assert np.abs(loads).max() <= 885


def test_tosses_fall_as_things_fall(tmp_path: Path) -> None:
    log = read_log(REAL / "cube_tosses" / "cube_tosses.npz", arm(tmp_path, CUBE))
    assert (len(log.recordings), log.body) == (285, "cube")
    # In the first rows the cube flies: its height falls with 9.81 m/s^2.
    falls = [
        2 * np.polyfit(part.time[:15], part.pose[:15, 2], 2)[0]
        for part in log.recordings
    ]
    assert np.median(falls) == pytest.approx(-9.81, rel=0.03)
