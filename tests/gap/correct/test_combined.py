"""A file of effects holds what was known and what changed since as one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from recorded_torques import XML, record_torques, wrong_everywhere
from small_problems import arm_problem
from small_verdicts import named

from rlco.gap import run_gap
from rlco.gap.correct.combined import combined
from rlco.gap.logs.log import Log
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.effects_file import read_effects


def test_what_was_known_of_the_same_number_is_added_and_else_listed() -> None:
    problem = arm_problem()
    # Friction at the elbow is 0.6 beside what is known, damping at the shoulder 0.6.
    verdict = replace(named(problem), sample=np.array([[0.6, 0.5], [0.7, 0.6]]))
    known = (
        AppliedEffect("coulomb_friction", "elbow", {"frictionloss": -0.1}),
        AppliedEffect("armature", "elbow", {"armature": 0.02}),
    )
    found = combined(known, verdict, problem.model)
    (armature, friction, damping) = found.hypothesis.effects
    assert armature == known[1]
    assert friction.parameters == {"frictionloss": pytest.approx(0.5)}
    assert damping.parameters == {"damping": 0.6}
    np.testing.assert_allclose(found.sample, [[0.5, 0.5], [0.6, 0.6]])


def test_factors_are_multiplied() -> None:
    problem = arm_problem()
    gain = AppliedEffect("actuator_gain", "elbow", {"factor": 0.5})
    verdict = named(problem)
    verdict = replace(verdict, hypothesis=replace(verdict.hypothesis, effects=(gain,)))
    known = (replace(gain, parameters={"factor": 1.2}),)
    (found,) = combined(known, verdict, problem.model).hypothesis.effects
    assert found.parameters == {"factor": pytest.approx(0.6)}


def write(log: Log, folder: Path) -> Path:
    folder.mkdir()
    for one in log.recordings:
        rows = [one.time, np.asarray(one.position), np.asarray(one.torque)]
        np.savetxt(
            folder / f"{one.name}.csv",
            np.column_stack(rows),
            delimiter=",",
            header="time,q.shoulder,q.elbow,tau.shoulder,tau.elbow",
            comments="",
        )
    return folder


@pytest.mark.slow
@pytest.mark.thorough
def test_a_friction_that_fell_is_named_and_written(tmp_path: Path) -> None:
    def rubs(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = 0.06

    def oiled(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = 0.01

    (tmp_path / "arm.xml").write_text(XML)
    first = record_torques(wrong_everywhere, rubs, seed=1)
    later = record_torques(wrong_everywhere, oiled, seed=3)
    finding = run_gap(
        tmp_path / "arm.xml",
        write(later, tmp_path / "after"),
        reference=write(first, tmp_path / "before"),
        threads=1,
    )
    (friction,) = finding.effects
    assert (friction.name, friction.target) == ("coulomb_friction", "elbow")
    change = friction.parameters["frictionloss"].value
    assert change == pytest.approx(-0.05, rel=0.3)
    # From what it was, not from the model's none.
    before = finding.known.joint("elbow").frictionloss[0]
    assert before == pytest.approx(0.06, rel=0.3)
    assert any(f"frictionloss {before:.4f} →" in line for line in finding.summary())
    assert finding.summary()[0].startswith("Changed: Coulomb friction")
    page = finding.write(tmp_path / "report").read_text("utf-8")
    assert "What changed" in page
    assert f"{before:.4f} →" in page
    listed = read_effects(tmp_path / "report" / "effects.yaml").effects
    (total,) = (
        one.parameters["frictionloss"]
        for one in listed
        if (one.name, one.target) == ("coulomb_friction", "elbow")
    )
    assert total == pytest.approx(before + change, abs=1e-5)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "report" / "model.xml"))
    assert model.joint("elbow").frictionloss[0] == pytest.approx(total, rel=1e-3)
