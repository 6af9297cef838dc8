"""The whole workflow, called by a program."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_problems import write_case

from rlco.errors import DataError, OutputExistsError, RlcoError
from rlco.gap import Finding, run_gap
from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.spec.domain import read_domain

DAMPING = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.6})
# Left out where it does not matter what else is tried.
MOST = set(EFFECTS) - {"viscous_damping", "coulomb_friction"}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_case(tmp_path_factory.mktemp("case"), DAMPING)


@pytest.fixture(scope="module")
def said() -> list[tuple[str, float]]:
    return []


@pytest.fixture(scope="module")
def finding(case: tuple[Path, Path], said: list[tuple[str, float]]) -> Finding:
    return run_gap(*case, threads=1, progress=lambda *step: said.append(step))


@pytest.mark.slow
def test_a_program_gets_what_was_found(finding: Finding) -> None:
    assert finding.complete
    assert finding.verdict.verdict == "named"
    (effect,) = finding.effects
    assert (effect.name, effect.target) == ("viscous_damping", "shoulder")
    assert effect.parameters["damping"].value == pytest.approx(0.6, rel=0.05)
    assert finding.gap.after_heldout < 0.1 * finding.gap.before_heldout
    assert finding.where.informative[0].target == "shoulder"
    assert len(finding.regimes) == len(finding.log.recordings) == 6
    assert finding.seconds >= finding.verdict.seconds > 0
    assert finding.summary()[0].startswith("Missing from the model: viscous")


def test_progress_tells_what_is_done_and_how_far_it_is(
    finding: Finding, said: list[tuple[str, float]]
) -> None:
    sentences = [sentence for sentence, _ in said]
    assert any(sentence.startswith("screening ") for sentence in sentences)
    assert "viscous_damping shoulder" in sentences
    assert all(0.0 <= part <= 1.0 for _, part in said)
    assert said[-1][1] == 1.0


def test_nothing_is_written_until_it_is_asked_for_and_then_nothing_simulated(
    finding: Finding,
    case: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert {path.name for path in case[0].parent.iterdir()} == {"arm.xml", "logs"}

    def simulated(*_: object) -> None:
        raise AssertionError("writing simulates")

    arm = "rlco.gap.compare.arm.rollouts.ArmRollouts"
    monkeypatch.setattr(f"{arm}.residuals", simulated)
    monkeypatch.setattr(f"{arm}.traces", simulated)
    page = finding.write(tmp_path / "new" / "report", command="make it")
    text = page.read_text("utf-8")
    assert "make it" in text
    # The robot as it moved, in the same file.
    assert text.count('<video src="data:video/mp4;base64,') == 1
    files = {path.name for path in page.parent.iterdir()}
    assert {"report.json", "model.xml", "model.diff", "effects.yaml"} <= files
    content = json.loads((page.parent / "report.json").read_text())
    assert content["effects"][0]["name"] == "viscous_damping"
    # Parameter sets about what was found, as wide as its interval.
    domain = read_domain(page.parent / "effects.yaml")
    assert domain.sample is not None
    damping = np.array(domain.sample.rows)[:, 0]
    value = finding.effects[0].parameters["damping"]
    assert damping.mean() == pytest.approx(value.value, abs=0.01 * value.value)
    within = (damping >= value.low) & (damping <= value.high)
    assert within.mean() == pytest.approx(0.9, abs=0.04)
    with pytest.raises(OutputExistsError):
        finding.write(page.parent)


@pytest.mark.slow
def test_an_interrupted_search_is_returned_and_can_be_written(
    case: tuple[Path, Path], tmp_path: Path
) -> None:
    stopped: list[str] = []

    def once(sentence: str, part: float) -> None:
        if part > 0 and not stopped:
            stopped.append(sentence)
            raise KeyboardInterrupt

    finding = run_gap(*case, exclude=MOST, threads=1, progress=once)
    assert not finding.complete
    assert not finding.motions
    assert [effect.name for effect in finding.effects] == ["viscous_damping"]
    page = finding.write(tmp_path / "report")
    assert "The search was stopped early" in page.read_text("utf-8")


@pytest.mark.slow
@pytest.mark.thorough
def test_an_interruption_after_the_search_keeps_its_verdict(
    case: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rlco.gap.workflow.recommend", interrupted)
    finding = run_gap(*case, exclude=MOST, threads=1)
    assert finding.verdict.complete
    assert not finding.complete
    assert finding.effects


def test_wrong_input_is_refused_before_anything_is_simulated(
    case: tuple[Path, Path], tmp_path: Path
) -> None:
    model, data = case
    with pytest.raises(RlcoError, match="is not a file"):
        run_gap(tmp_path / "nowhere.xml", data)
    with pytest.raises(DataError, match="does not exist"):
        run_gap(model, tmp_path / "nowhere")
    with pytest.raises(RlcoError, match="is not a file"):
        run_gap(model, data, effects_code=tmp_path / "nowhere.py")
