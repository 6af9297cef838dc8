"""What changed between two recordings of a robot whose model is wrong everywhere."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, commands, record
from recipe_cases import start
from recorded_torques import (
    XML,
    Array,
    loaded_hand,
    reaches,
    record_torques,
    sines,
    wrong_everywhere,
)
from small_problems import BALL

from rlco.errors import DataError, RlcoError, UnknownNameError
from rlco.gap import run_gap
from rlco.gap.calibrate.fit import Calibration
from rlco.gap.calibrate.numbers import Number
from rlco.gap.calibrate.optimism import optimism
from rlco.gap.compare.problem import Layout
from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs.log import Log, Recording
from rlco.gap.model import LoadedModel, load_model
from rlco.gap.reference import calibrates, prepare, search
from rlco.physics.effects import EFFECTS


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> LoadedModel:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(XML)
    return load_model(path)


@pytest.fixture(scope="module")
def before() -> Log:
    return record_torques(wrong_everywhere, seed=1)


def changed(
    arm: LoadedModel, before: Log, after: Log, exclude: Collection[str] = ()
) -> Verdict:
    prepared = prepare(
        arm, after, before, None, 1, lambda said, part: None, exclude=exclude
    )
    return search(prepared, exclude=exclude)[0]


def named(verdict: Verdict) -> list[tuple[str, str | None]]:
    return [(one.name, one.target) for one in verdict.effects]


@pytest.mark.thorough
def test_a_load_is_named_though_all_numbers_of_the_model_are_wrong(
    arm: LoadedModel, before: Log
) -> None:
    after = record_torques(wrong_everywhere, loaded_hand, seed=3)
    verdict = changed(arm, before, after)
    assert named(verdict) == [("payload", "lower")]
    mass = verdict.effects[0].parameters["mass"]
    assert mass.value == pytest.approx(0.1, rel=0.15)
    assert verdict.free_form is None


def pushed_along_its_path(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Push at the elbow by where it is, as no effect that is tried does."""
    data.qfrc_applied[1] = 0.1 * np.sin(3.0 * data.qpos[1])


@pytest.mark.thorough
def test_a_change_outside_the_library_is_drawn_at_its_joint(
    arm: LoadedModel, before: Log
) -> None:
    after = record_torques(wrong_everywhere, seed=3, act=pushed_along_its_path)
    free = changed(arm, before, after).free_form
    assert free is not None
    assert free.target == "elbow"
    position, torque = free.over_position
    pushed = 0.1 * np.sin(3.0 * position)
    assert np.corrcoef(torque, pushed)[0, 1] > 0.95
    assert np.std(torque) == pytest.approx(np.std(pushed), rel=0.3)


@pytest.mark.thorough
def test_a_factor_of_a_torque_is_named_and_not_converted(
    arm: LoadedModel, before: Log
) -> None:
    def in_other_units(torque: Array) -> None:
        torque[:, 1] *= 30.0

    verdict = changed(
        arm, before, record_torques(wrong_everywhere, seed=4, read=in_other_units)
    )
    assert named(verdict) == [("torque_scale", "elbow")]
    factor = verdict.effects[0].parameters["factor"]
    assert factor.value == pytest.approx(30.0, rel=0.05)


def without_friction(model: mujoco.MjModel) -> None:
    wrong_everywhere(model)
    model.dof_frictionloss[:] = 0.0


def rubbing_elbow(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] += 0.06


@pytest.mark.thorough
def test_a_friction_that_was_not_there_gets_no_other_beside_it(
    arm: LoadedModel,
) -> None:
    # At rest it has any size: that looks like friction by speed, load or a delay.
    first = record_torques(without_friction, seed=7, motion=reaches)
    later = record_torques(without_friction, rubbing_elbow, seed=8, motion=reaches)
    verdict = changed(arm, first, later)
    assert named(verdict) == [("coulomb_friction", "elbow")]
    assert not verdict.effects[0].rivals
    friction = verdict.effects[0].parameters["frictionloss"]
    assert friction.value == pytest.approx(0.06, rel=0.05)


def rippled(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Push at the elbow as no number of the model does."""
    data.qfrc_applied[1] = 0.05 * np.sin(7.0 * data.qpos[1])
    data.qfrc_applied[1] *= np.tanh(3.0 * data.qvel[1])


def a_move_and_a_long_rest(random: np.random.Generator) -> Array:
    """Return goals that move for 1.5 s and then rest for 6.5 s."""
    moves = sines(random, 1.5)
    moves *= np.linspace(3.0, 0.0, len(moves)).clip(max=1.0)[:, None]
    return np.concatenate([moves, np.repeat(moves[-1:], 325, axis=0)])


@pytest.mark.thorough
def test_long_rests_before_do_not_make_what_is_not_known_small(
    arm: LoadedModel,
) -> None:
    first = record_torques(
        wrong_everywhere, seed=1, motion=a_move_and_a_long_rest, act=rippled
    )
    later = record_torques(wrong_everywhere, seed=2, act=rippled)
    assert changed(arm, first, later).verdict == "no_change"


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (1, 2))]
)
def test_nothing_is_named_where_nothing_changed(arm: LoadedModel, seed: int) -> None:
    first, second = (
        record_torques(wrong_everywhere, seed=100 + 2 * seed + late)
        for late in range(2)
    )
    verdict = changed(arm, first, second)
    assert not verdict.effects
    assert not verdict.closest
    assert verdict.verdict == "no_change"


def write_csv(log: Log, folder: Path) -> Path:
    """Write a log of torques, one file a recording."""
    folder.mkdir()
    header = "time,q.shoulder,q.elbow,tau.shoulder,tau.elbow"
    for one in log.recordings:
        rows = np.column_stack(
            [one.time, np.asarray(one.position), np.asarray(one.torque)]
        )
        path = folder / f"{one.name}.csv"
        np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return folder


@pytest.fixture(scope="module")
def files(before: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "arm.xml").write_text(XML)
    write_csv(before, folder / "before")
    after = record_torques(wrong_everywhere, loaded_hand, seed=3)
    write_csv(after, folder / "after")
    return folder


@pytest.mark.thorough
def test_reports_show_before_after_and_the_difference(
    files: Path, tmp_path: Path
) -> None:
    finding = run_gap(
        files / "arm.xml", files / "after", reference=files / "before", threads=1
    )
    page = finding.write(tmp_path / "report").read_text("utf-8")
    assert "Before, after, and the difference" in page
    content = json.loads((tmp_path / "report" / "report.json").read_text())
    assert [one["name"] for one in content["effects"]] == ["payload"]
    assert not content["effects"][0]["calibrated"]
    for row in content["reference"]["channels"]:
        assert row["calibrated_rms"] < 0.2 * row["nominal_rms"]
        assert row["difference_left_rms"] < 0.5 * row["difference_rms"]
    # The corrected model is the robot as it is now, with what was wrong before.
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "report" / "model.xml"))
    assert model.dof_frictionloss[0] == pytest.approx(0.05, abs=0.015)
    assert model.body_mass.sum() > mujoco.MjModel.from_xml_string(XML).body_mass.sum()


@pytest.mark.slow
@pytest.mark.thorough
def test_the_recipe_tells_calibration_and_finding_apart(
    files: Path, tmp_path: Path
) -> None:
    model, out = f"model={files / 'arm.xml'}", tmp_path / "usual"
    start(
        "find_gap", model, f"data={files / 'before'}", "calibrate=usual", f"out={out}"
    )
    content = json.loads((out / "report.json").read_text())
    assert "reference" not in content
    assert all(one["calibrated"] for one in content["effects"])
    for row in content["calibration"]["channels"]:
        assert row["calibrated_rms"] < 0.3 * row["nominal_rms"]
    numbers = content["calibration"]["numbers"]
    away = [abs(one["prior_deviations"]) for one in numbers]
    assert away == sorted(away, reverse=True)
    page = (out / "report.html").read_text("utf-8")
    assert "<h2>Calibration</h2>" in page
    assert "After the calibration, over all recordings" in page
    before, after = f"reference={files / 'before'}", f"data={files / 'after'}"
    start("find_gap", model, before, after, f"out={tmp_path / 'changed'}")
    content = json.loads((tmp_path / "changed" / "report.json").read_text())
    assert [one["name"] for one in content["effects"]] == ["payload"]


def test_an_interruption_of_the_calibration_is_told_as_nothing_searched(
    files: Path,
) -> None:
    def stop(said: str, part: float) -> None:
        if said.startswith("calibrating"):
            raise KeyboardInterrupt

    finding = run_gap(
        files / "arm.xml",
        files / "after",
        reference=files / "before",
        threads=1,
        progress=stop,
    )
    assert not finding.complete
    assert finding.verdict.verdict == "unexplained"
    note = str(finding.verdict.unexplained["note"])
    assert note.startswith("Nothing was searched")


@pytest.mark.thorough
def test_a_delay_is_named_in_positions_and_in_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(TWO_LINKS)
    loaded = load_model(path)
    first = record(wrong_everywhere, episodes=3)
    later = record(wrong_everywhere, episodes=3, motion=lambda i: commands(50 + i))
    # Logged two rows before they reach the servos.
    late = replace(
        later,
        recordings=tuple(
            replace(one.take(slice(0, -2)), command=np.asarray(one.command)[2:])
            for one in later.recordings
        ),
    )
    near = {"command_delay", "actuator_lag", "control_rate", "armature"}
    others = set(EFFECTS) - near
    assert changed(loaded, first, later, others).verdict == "no_change"
    verdict = changed(loaded, first, late, others)
    assert named(verdict) == [("command_delay", None)]
    delay = verdict.effects[0].parameters["delay"].value
    assert delay == pytest.approx(0.04, rel=0.1)


def test_what_cannot_be_calibrated_is_refused_in_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    pose = np.tile([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], (50, 1))
    toss = Recording("toss", 0.01 * np.arange(50), pose=pose)
    log = Log((toss,), body="ball")
    with pytest.raises(DataError, match="reference= needs recordings of commands"):
        changed(load_model(path), log, log)


def test_two_robots_are_refused(arm: LoadedModel, before: Log) -> None:
    other = replace(before, joints=("shoulder", "wrist"))
    with pytest.raises(DataError, match="two recordings of one robot"):
        changed(arm, before, other)


def test_options_that_contradict_each_other_are_refused() -> None:
    assert not calibrates(None, False, None)
    assert calibrates(None, True, None)
    with pytest.raises(UnknownNameError, match="usual"):
        calibrates("always", False, None)
    with pytest.raises(RlcoError, match="leave calibrate= out"):
        calibrates("none", True, None)
    with pytest.raises(RlcoError, match="compare=positions"):
        calibrates("usual", False, "both")


def test_what_was_not_fitted_does_not_count_against_a_residual() -> None:
    """Of a hundred numbers one combination was fitted: a thousand rows are 999."""
    rows = 1000
    channel = np.zeros(rows, dtype=np.int64)
    time = np.arange(rows) / 2.0
    layout = Layout(channel, time, channel, ("elbow",), ("rad",))
    problem: Any = SimpleNamespace(layout=layout, noise=np.ones(1))
    # Of alternating sign: each row is one by itself.
    residual = np.where(np.arange(rows) % 2, 1.0, -1.0)
    numbers = (Number("link_parameters", "link", "x", 0.1),) * 100
    fitted = Calibration(
        numbers,
        np.zeros(100),
        np.eye(100)[:, :1],
        np.array([[1e9]]),
        1.0,
        rows,
        1.0,
        1.0,
    )
    assert optimism(problem, residual, fitted) == pytest.approx((1000 / 999) ** 0.5)
