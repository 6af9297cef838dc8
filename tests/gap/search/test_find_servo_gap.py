"""A servo on its bench: what is hidden in a pendulum is named, and no more."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import bench_runs
import numpy as np
import pytest
from bench_runs import write_bench, write_run
from html_page import Read

from rlco.errors import DataError, UnknownNameError
from rlco.gap import Finding, find_gap, load_model, make_problem, read_log, run_gap
from rlco.gap.compare.problem import Candidate
from rlco.gap.compare.servo.plant import SERVO_NUMBERS
from rlco.gap.compare.verdict import Verdict
from rlco.gap.search.servo.ladder import Judged, alone, groups_of, judge, ladder_of
from rlco.gap.search.servo.verdict import half_widths
from rlco.gap.servo_models import SERVOS
from rlco.physics.effects import EFFECTS

FRICTION, LOSS = "load_friction", "drive_loss"


def all_but(*names: str) -> set[str]:
    return set(EFFECTS) - set(names)


def found(folder: Path, *names: str, **options: float) -> Verdict:
    """Search a written bench for some effects only."""
    loaded = load_model("bam:xl330")
    log = read_log(write_bench(folder, **options), loaded)
    return find_gap(make_problem(loaded, log), exclude=all_but(*names))


@pytest.fixture(scope="module")
def finding(tmp_path_factory: pytest.TempPathFactory) -> Finding:
    """A drive that loses torque although its supply holds."""
    folder = write_bench(tmp_path_factory.mktemp("runs"), loss=0.8, sag=0.1)
    exclude = all_but(FRICTION, LOSS)
    return run_gap("bam:xl330", folder, exclude=exclude, threads=1)


@pytest.mark.slow
@pytest.mark.thorough
def test_a_loss_is_named_beside_the_servos_own_numbers(finding: Finding) -> None:
    verdict = finding.verdict
    (loss,) = verdict.effects
    assert (verdict.verdict, loss.name, loss.rivals) == ("named", LOSS, ())
    value = loss.parameters["loss"]
    assert value.value == pytest.approx(0.8, abs=0.01)
    assert value.low < 0.8 < value.high
    # An encoder of 4096 steps is off by turn / 4096 / sqrt(12).
    floor = 2.0 * math.pi / 4096.0 / math.sqrt(12.0)
    assert verdict.gap.after_heldout == pytest.approx(floor, rel=0.1)
    assert verdict.gap.before_heldout > 30.0 * floor
    own = verdict.hypothesis.effects[0]
    assert own.name == SERVO_NUMBERS
    servo = SERVOS["xl330"]
    fitted = {
        "gain": bench_runs.STALL / servo.stall(bench_runs.VOLTS) - 1.0,
        "feedback": bench_runs.BACK_EMF / servo.back_emf - 1.0,
        "damping": bench_runs.DAMPING / servo.damping - 1.0,
        "friction": bench_runs.FRICTION / servo.frictionloss - 1.0,
        "zero": bench_runs.ZERO,
    }
    assert {name: own.parameters[name] for name in fitted} == pytest.approx(
        fitted, abs=0.02
    )


def test_every_gain_is_judged_by_fits_that_have_not_seen_it(finding: Finding) -> None:
    held_out = finding.verdict.held_out
    assert held_out is not None
    assert [group.label for group in held_out.groups] == ["kp 100", "kp 300", "kp 800"]
    seen = [index for group in held_out.groups for index in group.recordings]
    assert sorted(seen) == list(range(6))
    assert (held_out.numbers_before, held_out.numbers_after) == (6, 7)
    names = [finding.log.recordings[i].name for i in held_out.groups[0].recordings]
    assert names == ["sines_100 sines", "steps_100 steps"]
    problem = make_problem(load_model("bam:xl330"), finding.log)
    for group in held_out.groups:
        rows = problem.residuals([group.hypothesis_after], group.recordings)[0]
        assert group.after == pytest.approx(np.abs(rows).mean())
        assert group.after < 0.1 * group.before


def test_the_reports_hold_what_was_held_out_and_the_volts(
    finding: Finding, tmp_path: Path
) -> None:
    page = Read(finding.write(tmp_path / "out").read_text("utf-8"))
    content = json.loads((tmp_path / "out" / "report.json").read_text())
    held_out, verdict = content["held_out"], finding.verdict.held_out
    assert verdict is not None
    assert held_out["after"] == pytest.approx(verdict.after)
    assert [group["name"] for group in held_out["groups"]] == [
        group.label for group in verdict.groups
    ]
    remark, own = content["remarks"]
    assert "torque constant 0.323 ->" in own
    assert "zero is at 30 mrad" in own
    assert remark.startswith("The measured volts contradict a sagging supply")
    assert remark in page.text
    assert "Held out in turn" in page.text
    assert "Each of kp 100, kp 300 and kp 800 was held out once" in page.text
    assert any("kp" in alt or "held out" in alt for alt in page.alts)
    assert remark in " ".join(finding.summary())
    assert "2 fitted" not in page.text


@pytest.mark.slow
def test_a_supply_that_sags_is_borne_out(tmp_path: Path) -> None:
    verdict = found(tmp_path, LOSS, loss=0.8, sag=2.0)
    assert "support" in verdict.remarks[0]


@pytest.mark.slow
def test_friction_with_the_load_is_named_alone(tmp_path: Path) -> None:
    verdict = found(tmp_path, FRICTION, LOSS, ratio=0.2)
    (friction,) = verdict.effects
    assert (friction.name, friction.rivals) == (FRICTION, ())
    assert friction.parameters["ratio"].value == pytest.approx(0.2, abs=0.005)
    assert friction.evidence[f"{LOSS} servo"] > 1.0
    # Nothing is lost, so no volts need fall.
    assert not any("volts" in remark for remark in verdict.remarks)


def test_a_servo_of_other_numbers_lacks_nothing(tmp_path: Path) -> None:
    verdict = found(tmp_path, FRICTION, LOSS)
    assert (verdict.verdict, verdict.effects) == ("no_gap", ())
    assert verdict.gap.after_heldout == verdict.gap.before_heldout
    assert verdict.unexplained["share"] == 0.0
    assert verdict.held_out is not None
    assert verdict.held_out.nominal > 30.0 * verdict.held_out.after


def test_what_is_not_in_the_library_is_not_named(tmp_path: Path) -> None:
    verdict = found(tmp_path, "gravity_tilt", ratio=0.2)
    assert (verdict.verdict, verdict.effects) == ("unexplained", ())
    assert verdict.unexplained["share"] == pytest.approx(1.0)
    assert "kp 100" in str(verdict.unexplained["note"])
    (closest,) = verdict.closest
    assert closest[0] == Candidate("gravity_tilt", None)


@pytest.mark.slow
def test_ctrl_c_keeps_the_best_so_far(tmp_path: Path) -> None:
    loaded = load_model("bam:xl330")
    problem = make_problem(loaded, read_log(write_bench(tmp_path, ratio=0.2), loaded))

    def stop(sentence: str, part: float) -> None:
        assert 0.0 <= part <= 1.0
        if sentence.startswith("load friction"):
            raise KeyboardInterrupt

    verdict = find_gap(problem, exclude=all_but(FRICTION), on_step=stop)
    assert not verdict.complete
    assert [effect.name for effect in verdict.effects] == [FRICTION]


def test_a_ctrl_c_before_the_first_fit_says_that_nothing_was_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = load_model("bam:xl330")
    problem = make_problem(loaded, read_log(write_bench(tmp_path), loaded))

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rlco.gap.search.servo.find_servo_gap.alone", stop)
    verdict = find_gap(problem)
    assert not verdict.complete
    assert "Nothing was searched" in str(verdict.unexplained["note"])


def test_what_is_held_out_together(tmp_path: Path) -> None:
    loaded = load_model("bam:xl330")
    write_bench(tmp_path / "a", gains=(800.0, 90.0))
    by_gain = groups_of(read_log(tmp_path / "a", loaded))
    assert [group.label for group in by_gain] == ["kp 90", "kp 800"]
    assert by_gain[0].train == by_gain[1].heldout
    write_bench(tmp_path / "b", gains=(200.0,))
    for index, mass in enumerate((0.3, 0.5)):
        file = write_run(tmp_path / "c", f"run{index}", 200.0, "sines")
        file.write_text(re.sub('"mass": [0-9.]+', f'"mass": {mass}', file.read_text()))
    by_load = groups_of(read_log(tmp_path / "c", loaded))
    assert [group.label for group in by_load] == [
        "mass 0.3 length 0.1",
        "mass 0.5 length 0.1",
    ]
    alike = groups_of(read_log(tmp_path / "b", loaded))
    assert [group.label for group in alike] == ["part 1 of 2", "part 2 of 2"]
    write_run(tmp_path / "d", "one", 200.0, "sines", seconds=5.0)
    with pytest.raises(DataError, match=r"one recording of the servo: .* at least two"):
        groups_of(read_log(tmp_path / "d", loaded))


def test_an_interval_grows_with_how_much_the_groups_disagree() -> None:
    values = np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [2.0, 0.0]])
    # Squares of 2 about the mean, times 3 / 4; Student's t for 3 is 2.353.
    expected = 2.353363 * math.sqrt(0.75 * 2.0)
    np.testing.assert_allclose(half_widths(values), [expected, 0.0], rtol=1e-5)


@pytest.mark.parametrize("numbers", [6, 7])
def test_numbers_are_counted_with_the_servos_own(tmp_path: Path, numbers: int) -> None:
    loaded = load_model("bam:xl330")
    folder = write_bench(tmp_path, gains=(100.0, 800.0))
    problem = make_problem(loaded, read_log(folder, loaded))
    ladder = ladder_of(problem, all_but(LOSS))
    judged: Judged = alone(ladder)
    if numbers == 7:
        judged = judge(ladder, judged, Candidate(LOSS, "servo"))
    assert judged.parameters == numbers


def test_an_unknown_servo_is_told_of_the_known_ones() -> None:
    message = r"unknown servo 'xl33' \(did you mean 'xl330'\?\); known: xl330\."
    with pytest.raises(UnknownNameError, match=message):
        load_model("bam:xl33")


def test_recordings_of_another_servo_are_refused(tmp_path: Path) -> None:
    write_run(tmp_path, "run", 100.0, "sines", motor="mx64", seconds=5.0)
    with pytest.raises(DataError, match="is of mx64 and model=bam:xl330 is another"):
        run_gap("bam:xl330", tmp_path)


def test_recordings_that_are_of_no_bench_are_refused(tmp_path: Path) -> None:
    time = np.arange(0.0, 6.0, 0.01)
    columns = np.column_stack([time, np.sin(time), np.sin(time)])
    file = tmp_path / "run.csv"
    np.savetxt(file, columns, delimiter=",", header="time,servo,cmd_servo", comments="")
    with pytest.raises(DataError, match="lacks mass, length, vin and kp: a servo on"):
        run_gap("bam:xl330", file)


PENDULUM = """<mujoco><option timestep="0.005"/><worldbody><body><joint name="pin"
axis="0 -1 0" damping=".05" armature=".002"/><inertial mass=".49" pos="0 0 -.1"
diaginertia="1e-6 1e-6 1e-6"/></body></worldbody><actuator><position joint="pin"
kp="2"/></actuator></mujoco>"""


def test_a_model_of_one_stiffness_is_not_for_many_gains(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(PENDULUM)
    loaded = load_model(tmp_path / "arm.xml")
    log = read_log(write_bench(tmp_path / "logs"), loaded)
    message = "3 gains of its firmware, kp 100, 300, 800, .* give model=bam:xl330"
    with pytest.raises(DataError, match=message):
        make_problem(loaded, log)


def test_a_model_for_one_gain_is_told_of_the_bench(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(PENDULUM)
    loaded = load_model(tmp_path / "arm.xml")
    log = read_log(write_bench(tmp_path / "logs", gains=(200.0,)), loaded)
    notes = make_problem(loaded, log).log.notes
    assert any("model=bam:xl330 compares them with its firmware" in n for n in notes)
