"""A domain's file: written, read again, and refused where it is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rlco.errors import DataError, RlcoError, UnknownNameError
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import read_effects, write_effects
from rlco.physics.spec.domain import (
    STAND_IN,
    Domain,
    make_domain,
    with_effects,
    with_look,
    write_domain,
)
from rlco.physics.spec.sensors import Sensors

NUMBERS = st.floats(-1.0, 1.0)
SIZES = st.floats(0.0, 1.0)
DAMPING = AppliedEffect("viscous_damping", "joint4", {"damping": 8.0})


@settings(max_examples=40, deadline=None)
@given(
    sensors=st.builds(
        Sensors,
        camera_yaw=NUMBERS,
        camera_shift=st.tuples(NUMBERS, NUMBERS),
        object_noise=SIZES,
        state_noise=SIZES,
        tool_offset=NUMBERS,
        gripper_offset=NUMBERS,
    )
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, sensors: Sensors
) -> None:
    path = tmp_path_factory.mktemp("file") / "robot.yaml"
    domain = Domain("robot", (*STAND_IN.effects, DAMPING), sensors)
    write_domain(path, domain)
    assert make_domain(path) == domain
    assert make_domain(str(path)) == domain


def test_a_file_without_sensors_has_those_of_sim(tmp_path: Path) -> None:
    path = tmp_path / "gap.yaml"
    write_effects(path, [DAMPING], names={"joint4": "robot0_joint4"})
    assert "version: 1" in path.read_text()
    there = replace(DAMPING, target="robot0_joint4")
    assert make_domain(path) == Domain("gap", (there,), Sensors())


def test_sensors_that_a_file_leaves_out_are_those_of_sim(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "effects: []\nsensors: {camera_shift: [0.02, 0], tool_offset: 0.01}"
    )
    expected = Sensors(camera_shift=(0.02, 0.0), tool_offset=0.01)
    assert make_domain(path).sensors == expected
    assert expected.object_noise == make_domain("sim").sensors.object_noise > 0.0


def test_sensors_and_a_look_make_it_a_file_that_older_readers_refuse(
    tmp_path: Path,
) -> None:
    path = tmp_path / "robot.yaml"
    for domain, version in ((STAND_IN, 3), (with_look(STAND_IN, "sim"), 2)):
        write_domain(path, domain)
        assert f"version: {version}" in path.read_text()
        assert read_effects(path).effects == STAND_IN.effects


def test_effects_are_added_to_a_domain() -> None:
    both = with_effects(with_effects(STAND_IN, [DAMPING]), None)
    assert both.effects == (*STAND_IN.effects, DAMPING)
    assert (both.name, both.sensors) == (STAND_IN.name, STAND_IN.sensors)
    slower = AppliedEffect("controller_stiffness", None, {"factor": 0.5})
    assert with_effects(STAND_IN, [slower]).stiffness_scale == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("effects: [", "is no YAML"),
        ("effects: []\nsensors: {camera_yow: 1}", "'camera_yow'.*mean 'camera_yaw'"),
        ("effects: []\nsensors: {camera_yaw: much}", "'much'; give a number"),
        ("effects: []\nsensors: {camera_yaw: .nan}", "nan; give a number"),
        ("effects: []\nsensors: {camera_shift: 0.1}", "give two numbers, x and y"),
        ("effects: []\nsensors: {camera_shift: [1, 2, 3]}", "give two numbers"),
        ("effects: []\nsensors: {object_noise: -0.1}", "give 0 or more"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(content)
    with pytest.raises(DataError, match=message) as caught:
        make_domain(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (
            AppliedEffect("scene_mas", None, {"factor": 1.0}),
            "did you mean 'scene_mass'",
        ),
        (AppliedEffect("scene_mass", "cube", {"factor": 1.0}), "give no target"),
        (
            AppliedEffect("scene_mass", None, {"mass": 1.0}),
            "parameter is factor, given",
        ),
        (AppliedEffect("scene_mass", None, {"factor": 0.0}), "give a number above 0"),
        (AppliedEffect("scene_mass", None, {"factor": float("nan")}), "above 0"),
        (AppliedEffect("backlash", "joint4", {"width": 0.1}), "no goals of their own"),
        ("scene_mass", "a list of AppliedEffect"),
    ],
)
def test_an_effect_that_no_task_can_have_is_refused(effect: Any, message: str) -> None:
    with pytest.raises(RlcoError, match=message):
        Domain("robot", (effect,))


def test_names_and_paths_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"'stand_inn' \(did you mean 'stand_in"):
        make_domain("stand_inn")
    with pytest.raises(UnknownNameError, match=r"stand_in, the path of a domain's"):
        make_domain("robot")
    for path in ("robot.yaml", "no/robot", tmp_path / "robot"):
        with pytest.raises(DataError, match=r"is missing; give an effects\.yaml"):
            make_domain(path)
    with pytest.raises(DataError, match=r"is no file; give an effects"):
        make_domain(tmp_path)


def test_a_file_may_not_take_the_name_of_a_domain(tmp_path: Path) -> None:
    path = tmp_path / "sim.yaml"
    write_effects(path, [DAMPING])
    with pytest.raises(DataError, match="name of one of rlco's own domains; rename it"):
        make_domain(path)


def test_effects_do_not_take_sensors_along_in_silence(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    write_domain(path, STAND_IN)
    with pytest.raises(DataError, match=r"has sensors.*give it as domain="):
        with_effects(STAND_IN, path)


SLIPPERY = replace(STAND_IN, name="slippery")
SIM = Domain("sim", (DAMPING,))


def test_a_domain_of_ones_own_module() -> None:
    assert make_domain(f"{__name__}:SLIPPERY") is SLIPPERY


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("no_such_module:SLIPPERY", ["cannot import 'no_such_module'", "PYTHONPATH=."]),
        (f"{__name__}:NUMBERS", ["no Domain named 'NUMBERS'"]),
        (f"{__name__}:SIM", ["filed under 'sim'", "another name="]),
        ("slippery", ["unknown domain 'slippery'", "MODULE:NAME"]),
        (":SLIPPERY", ["cannot import ''"]),
    ],
)
def test_a_domain_that_cannot_be_had_is_refused(given: str, words: list[str]) -> None:
    with pytest.raises(RlcoError) as caught:
        make_domain(given)
    for word in words:
        assert word in str(caught.value)
