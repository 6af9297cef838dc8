"""Degrees or radians: detected, converted, or asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from log_cases import ARM, JOINTS, arm, motion, write_csv

from rlco.errors import DataError, UnknownNameError
from rlco.gap.logs import read_log
from rlco.gap.logs.log import Log, Recording
from rlco.gap.logs.units import to_radians

FREE = ARM.replace('limited="true"', 'limited="false"')
DEGREE = 180.0 / np.pi


def log(position: float = 1.0, velocity: float = 1.0, command: float = 1.0) -> Log:
    """The motion, each channel times a number."""
    time, angles, sent = motion()
    speeds = np.gradient(angles, time, axis=0)
    part = Recording("log", time, angles * position, speeds * velocity, sent * command)
    return Log((part,), joints=JOINTS, actuators=("m1", "m2", "m3"))


@pytest.mark.parametrize("xml", [ARM, FREE], ids=["limited", "unlimited"])
@pytest.mark.parametrize(
    "units", [(1, 1, 1), (1, 0, 1), (0, 1, 1), (1, 1, 0), (0, 0, 1)]
)
def test_every_mixture_of_units_comes_out_in_radians(
    tmp_path: Path, xml: str, units: tuple[int, ...]
) -> None:
    model = arm(tmp_path, xml).model
    truth = log().recordings[0]
    given = log(*[DEGREE if unit else 1.0 for unit in units])
    found = to_radians(given, model)
    for channel in ("position", "velocity", "command"):
        np.testing.assert_allclose(
            getattr(found.recordings[0], channel), getattr(truth, channel), rtol=1e-12
        )
    assert "degrees" in found.notes[0]


def test_radians_stay_as_they_are_without_a_note(tmp_path: Path) -> None:
    given = log()
    assert to_radians(given, arm(tmp_path).model) is given


def test_slides_motors_and_torques_are_no_angles(tmp_path: Path) -> None:
    xml = ARM.replace('name="wrist" axis="1 0 0"', 'name="wrist" type="slide"')
    xml = xml.replace(
        '<position name="m2" joint="elbow" kp="20" kv="1"/>',
        '<motor name="m2" joint="elbow"/>',
    )
    given = log(DEGREE, DEGREE, DEGREE)
    part = given.recordings[0]
    given = replace(given, recordings=(replace(part, torque=part.position),))
    found = to_radians(given, arm(tmp_path, xml).model).recordings[0]
    np.testing.assert_allclose(found.position[:, 0] * DEGREE, part.position[:, 0])
    np.testing.assert_array_equal(found.position[:, 2], part.position[:, 2])
    np.testing.assert_array_equal(found.command[:, 1:], part.command[:, 1:])
    np.testing.assert_array_equal(found.torque, part.position)


def test_a_single_joint_beyond_a_turn_is_asked_for() -> None:
    time = np.arange(300) * 0.02
    part = Recording("log", time, 8 * np.sin(time)[:, None])
    one = Log((part,), joints=("j",))
    with pytest.raises(DataError, match="may be degrees or radians; give angles="):
        to_radians(one)
    assert to_radians(one, angles="radians") is one
    told = to_radians(one, angles="degrees").recordings[0]
    np.testing.assert_allclose(told.position * DEGREE, part.position)


def test_a_single_joint_faster_than_any_arm_is_in_degrees() -> None:
    time = np.arange(300) * 0.02
    part = Recording("log", time, 60 * np.sin(time)[:, None])
    found = to_radians(Log((part,), joints=("j",)))
    np.testing.assert_allclose(found.recordings[0].position * DEGREE, part.position)


def test_degrees_taken_for_radians_are_refused(tmp_path: Path) -> None:
    model = arm(tmp_path).model
    with pytest.raises(DataError, match="as radians and inside them as degrees; give"):
        to_radians(log(DEGREE, DEGREE, DEGREE), model, "radians")


def test_radians_taken_for_degrees_are_refused(tmp_path: Path) -> None:
    # This elbow cannot be straight, which is where a few degrees would have it.
    xml = ARM.replace("-2.5 0.5", "-2.5 -0.6")
    time, angles, _ = motion()
    angles[:, 1] = -1.6 + 0.8 * np.sin(time)
    given = Log((Recording("log", time, angles),), joints=JOINTS)
    with pytest.raises(DataError, match="as degrees and inside them as radians"):
        to_radians(given, arm(tmp_path, xml).model, "degrees")


def test_a_wheel_may_turn_on_and_on() -> None:
    xml = """<mujoco><worldbody><body name="w"><joint name="w" axis="0 1 0"/>
    <geom size=".1"/></body></worldbody>
    <actuator><velocity name="w" joint="w" kv="1"/></actuator></mujoco>"""
    import mujoco

    time = np.arange(300) * 0.02
    part = Recording("log", time, 40 * time[:, None], command=np.ones((300, 1)))
    given = Log((part,), joints=("w",), actuators=("w",))
    assert to_radians(given, mujoco.MjModel.from_xml_string(xml)) is given


def test_headers_may_tell_the_unit(tmp_path: Path) -> None:
    time = np.arange(300) * 0.02
    columns = {"time": time, "arm [deg]": 5 * np.sin(time)}
    log = read_log(write_csv(tmp_path / "a.csv", columns))
    np.testing.assert_allclose(
        log.recordings[0].position[:, 0] * DEGREE, columns["arm [deg]"], atol=1e-7
    )


def test_other_units_in_headers_are_converted(tmp_path: Path) -> None:
    time, angles, sent = motion()
    speeds = np.gradient(angles, time, axis=0)
    columns = {"time": time}
    for i, name in enumerate(JOINTS):
        columns[f"{name} [mrad]"] = 1e3 * angles[:, i]
        columns[f"vel_{name} [rpm]"] = speeds[:, i] * 60.0 / (2.0 * np.pi)
        columns[f"cmd_{name} (rev)"] = sent[:, i] / (2.0 * np.pi)
    file = write_csv(tmp_path / "a.csv", columns)
    log = read_log(file, arm(tmp_path))
    (found,) = log.recordings
    for channel, truth in (
        (found.position, angles),
        (found.velocity, speeds),
        (found.command, sent),
    ):
        np.testing.assert_allclose(channel, truth, atol=1e-6)
    (note,) = [note for note in log.notes if "units in their headers" in note]
    assert f"{JOINTS[0]} [mrad], vel_{JOINTS[0]} [rpm]" in note
    # A factor that is given is the only one.
    known = {name: 1e-3 for name in columns if "[mrad]" in name}
    again = read_log(file, arm(tmp_path), scale=known).recordings[0].position
    np.testing.assert_allclose(again, angles, atol=1e-6)


def test_a_pose_in_millimetres_is_converted(tmp_path: Path) -> None:
    time = np.arange(300) * 0.02
    columns = {"time": time} | {f"{axis} [mm]": 1e3 * time for axis in "xyz"}
    columns |= {"qw": 1 + 0 * time} | {f"q{axis}": 0 * time for axis in "xyz"}
    pose = read_log(write_csv(tmp_path / "a.csv", columns)).recordings[0].pose
    np.testing.assert_allclose(pose[:, 0], time, atol=1e-9)


def test_another_word_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'degrees'"):
        to_radians(log(), angles="degree")


def test_one_recording_that_ran_away_does_not_decide_the_unit(tmp_path: Path) -> None:
    model = arm(tmp_path).model
    calm, wild = log(), log(1e4)
    recordings = tuple(
        replace((wild if i == 2 else calm).recordings[0], name=f"run {i}")
        for i in range(4)
    )
    found = to_radians(replace(calm, recordings=recordings), model)
    assert [part.name for part in found.recordings] == ["run 0", "run 1", "run 3"]
    for part in found.recordings:
        np.testing.assert_array_equal(part.position, calm.recordings[0].position)
    (note,) = found.notes
    assert "'run 2' is left out: elbow reaches 1.9e+04 in it" in note


def test_a_wide_motion_in_degrees_beside_small_ones_is_no_runaway(
    tmp_path: Path,
) -> None:
    parts = [
        replace(log(DEGREE * size, DEGREE * size).recordings[0], command=None)
        for size in (0.01, 0.01, 1.0, 0.01)
    ]
    given = Log(tuple(parts), joints=JOINTS)
    found = to_radians(given, arm(tmp_path).model)
    assert len(found.recordings) == 4
    np.testing.assert_allclose(
        found.recordings[2].position, log().recordings[0].position, rtol=1e-12
    )
