"""The page on hobby arms: its simulated arm, its commands, and what is hidden in it."""

from __future__ import annotations

import functools
import importlib.util
import json
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
from pages import DOCS, run_python
from recipe_cases import start

import rlco.gap
from rlco.gap import check_effects, load_model, read_log
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import write_effects

NO_JAW = {"gripper": "-"}
HIDDEN = (
    AppliedEffect("coulomb_friction", "elbow_flex", {"frictionloss": 0.15}),
    AppliedEffect(
        "payload", "wrist_roll_link", {"mass": 0.12, "x": 0.02, "y": 0.0, "z": 0.05}
    ),
)
# A search that leaves these out takes a third of the time.
UNLIKELY = (
    "backlash",
    "cogging",
    "directional_friction",
    "hardening_spring",
    "joint_compliance",
    "link_inertia",
    "load_friction",
    "random_delay",
    "stribeck_friction",
    "velocity_limit",
)


@pytest.fixture(scope="module")
def hobby_arm() -> ModuleType:
    spec = importlib.util.spec_from_file_location("hobby_arm", DOCS / "hobby_arm.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(hobby_arm: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("so101") / "hobby_arm"
    hobby_arm.write(out, episodes=3, seconds=6.0)
    return out


def test_the_arm_is_of_the_sizes_and_servos_that_the_page_names(
    hobby_arm: ModuleType,
) -> None:
    model = mujoco.MjModel.from_xml_string(hobby_arm.arm_xml())
    # By hand: 1.178 N m/A * 7.4 V / 2.479 ohm is 3.516 N m, times 0.97; and times 0.166
    # * 1.005 of the voltage per radian and unit of P, times 16.
    assert model.actuator_forcerange[0, 1] == pytest.approx(3.411, abs=1e-3)
    assert model.actuator_gainprm[0, 0] == pytest.approx(9.386, abs=5e-3)
    assert model.body_mass.sum() < 1.0


def test_the_recordings_are_as_lerobot_writes_them(
    hobby_arm: ModuleType, folder: Path
) -> None:
    loaded = load_model(folder / "arm.xml")
    log = read_log(folder / "recordings", loaded, angles="degrees", rename=NO_JAW)
    assert len(log.recordings) == 3
    one = log.recordings[0]
    np.testing.assert_allclose(np.diff(one.time), 1 / 30, rtol=1e-5)
    # The gripper, which the model lacks and LeRobot gives in per cent, is left out.
    assert log.joints == hobby_arm.JOINTS[:-1]
    # Encoders of 12 bits, the leader's too.
    for values in (one.position, one.command):
        counts = np.asarray(values) * 4096 / (2 * np.pi)
        np.testing.assert_allclose(counts, np.round(counts), atol=2e-3)
        assert np.ptp(counts[:, -1]) > 100
    # BAM's servo follows no goal faster than this, which MJCF has no word for.
    speed = np.diff(np.asarray(one.command), axis=0) * 30
    assert np.abs(speed).max() < 5.3


def test_what_is_hidden_is_all_that_is_wrong(folder: Path, tmp_path: Path) -> None:
    write_effects(tmp_path / "hidden.yaml", HIDDEN)
    found = check_effects(
        folder / "arm.xml",
        folder / "recordings",
        tmp_path / "hidden.yaml",
        angles="degrees",
        rename=NO_JAW,
        threads=1,
    )
    before, after = np.asarray(found.before), np.asarray(found.after)
    elbow = found.channels.index("elbow_flex")
    assert before[elbow] > 10 * after[elbow]
    # Beside the encoder's steps of 1.5 mrad (0.44 root mean square) there is the jaw:
    # 20 g that move.
    assert (after < 0.8e-3).all()


@pytest.mark.thorough
def test_the_pages_search_names_what_is_hidden_and_no_more(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shorter = functools.partial(rlco.gap.run_gap, exclude=UNLIKELY)
    monkeypatch.setattr(rlco.gap, "run_gap", shorter)
    out = tmp_path / "hobby_report"
    start(
        "find_gap",
        f"model={folder / 'arm.xml'}",
        f"data={folder / 'recordings'}",
        "angles=degrees",
        "rename=gripper:-",
        f"out={out}",
        "film=false",
    )
    said = json.loads((out / "report.json").read_text())
    assert said["complete"]
    assert said["verdict"] == "named"
    assert said["gap"]["after"]["heldout_rms"] < 1.3 * said["gap"]["noise_floor"]
    named = {(one["name"], one["target"]): one["parameters"] for one in said["effects"]}
    assert set(named) == {(one.name, one.target) for one in HIDDEN}
    for effect in HIDDEN:
        # Where the payload is holds the jaw, too, which the model does not move.
        first = next(iter(effect.parameters))
        found = named[effect.name, effect.target][first]
        assert found["low"] < effect.parameters[first] < found["high"]


def test_the_pages_factors_are_those_of_lerobots_units() -> None:
    made = run_python("so101.md", "## Normalised units")
    # By hand: half of 1000 to 3000 counts is 1000 counts, 87.89 degrees, for 100 units.
    assert made["scale"].split(",")[0] == "observation.state.elbow_flex.pos:0.8789"
