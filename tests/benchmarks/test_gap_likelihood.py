"""Which wrong names recordings refute: a likelihood ratio, by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gap_cases
import numpy as np
import pytest
from gap_arms import Array
from gap_baselines import Logged, hidden_of, read_case, split
from gap_likelihood import distinguishable, evidence, refitted
from gap_plant import make_plant
from gap_recording import record

Row = dict[str, Any]


def answer(name: str, target: str, **values: float) -> Row:
    numbers = {
        key: {"value": v, "low": v - 0.01 * abs(v), "high": v + 0.01 * abs(v)}
        for key, v in values.items()
    }
    return {"name": name, "target": target, "parameters": numbers}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Logged, Row]:
    folder = tmp_path_factory.mktemp("case")
    wanted = ("viscous_damping",)
    one = gap_cases.Case("x", "leave_out", "servo", "excite", wanted, 1.0, 4)
    truth = gap_cases.make_case(one, folder)
    return read_case(folder), truth


def played(logged: Logged, effects: list[Row]) -> Array:
    plant, random = make_plant(logged.xml, hidden_of(effects)), np.random.default_rng(0)
    _, held = split(len(logged.positions))
    rows = [record(plant, logged.commands[i], logged.fps, random) for i in held]
    return np.concatenate([row.position.ravel() for row in rows])


def test_evidence_against_nothing_is_what_the_effect_changes(
    case: tuple[Logged, Row],
) -> None:
    logged, truth = case
    away = (played(logged, []) - played(logged, truth["effects"])) / truth["noise"]
    expected = float(np.sum(away**2))
    # Noise moves it by its projection on the change: sd 2 |change|.
    found = evidence(logged, [], truth)
    assert found["numbers"] == len(away)
    assert found["evidence"] == pytest.approx(expected, abs=8 * np.sqrt(expected))
    assert distinguishable(found)


@pytest.mark.thorough
def test_a_value_that_is_a_little_off_is_no_evidence(case: tuple[Logged, Row]) -> None:
    logged, truth = case
    damping = truth["effects"][0]["parameters"]["damping"]
    off = [answer("viscous_damping", "joint1", damping=1.05 * damping)]
    fitted = refitted(logged, off)
    assert fitted[0]["damping"] == pytest.approx(damping, rel=5e-3)
    assert not distinguishable(evidence(logged, off, truth))


@pytest.mark.thorough
def test_another_effect_at_the_joint_is_refuted(case: tuple[Logged, Row]) -> None:
    logged, truth = case
    friction = [answer("coulomb_friction", "joint1", frictionloss=0.05)]
    assert distinguishable(evidence(logged, friction, truth))


@pytest.mark.thorough
def test_a_plant_that_diverges_is_no_evidence(
    case: tuple[Logged, Row], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file there
    logged, truth = case
    rigid = answer("joint_compliance", "joint1", compliance=1e-5)
    assert evidence(logged, [rigid], truth) == {}
    assert distinguishable({}) is None


def test_a_named_cogging_is_two_waves() -> None:
    numbers = {"amplitude": 0.3, "count": 12.0, "phase": 0.4}
    numbers |= {"second_sine": 0.1, "second_cosine": -0.2}
    named = {"name": "cogging", "target": "joint1", "parameters": numbers}
    angle = np.linspace(-2.0, 2.0, 101)
    turn = 12.0 * angle + 0.4
    expected = 0.3 * np.sin(turn) + 0.1 * np.sin(2 * turn) - 0.2 * np.cos(2 * turn)
    waves = [
        one["amplitude"] * np.sin(one["count"] * angle + one["phase"])
        for one in hidden_of([named])
    ]
    np.testing.assert_allclose(sum(waves), expected, atol=1e-12)
