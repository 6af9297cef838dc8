"""What the spread does is measured again where effects make an arm sensitive to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, record
from recorded_torques import XML, loaded_hand, record_torques, wrong_everywhere

from rlco.gap.calibrate.remaining import SPREAD
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.model import load_model
from rlco.gap.reference import prepare
from rlco.gap.search.fit import linearise
from rlco.gap.search.state import State
from rlco.gap.search.steps.sensitivity import rewhiten
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect


@pytest.fixture
def state(monkeypatch: pytest.MonkeyPatch) -> State:
    """A state whose best effect, much damping, always counts as sensitive."""
    monkeypatch.setattr("rlco.gap.search.steps.sensitivity.GREW", 0.0)
    spec = mujoco.MjSpec.from_string(TWO_LINKS)
    first = start(ArmRollouts(spec, record(), np.full(2, 4e-4)))
    much = AppliedEffect("viscous_damping", "shoulder", {"damping": 3.0})
    first, (found,) = first.fit([[much]])
    return replace(first, best=found)


def test_what_was_tried_is_forgotten_where_the_spread_weighs_otherwise(
    state: State,
) -> None:
    setting = state.setting
    nothing = linearise(setting.library, (), setting.whiten)
    (before,) = setting.score([nothing])
    again = rewhiten(state)
    assert again.scores.keys() == {frozenset(), again.best.names}
    assert again.none.error != pytest.approx(before.error, rel=1e-5)
    assert not np.allclose(again.setting.weights.moved, setting.weights.moved)


def test_the_weights_and_the_fits_of_a_state_are_of_one_spread(state: State) -> None:
    """Scores that were weighted otherwise cannot be compared."""
    again = rewhiten(state)
    for one in again.scores.values():
        rows = np.hstack(
            [
                again.setting.residuals([one.effects], part)
                for part in (again.setting.train, again.setting.heldout)
            ]
        )
        whitened = again.setting.weights.together.whiten(rows[0])
        np.testing.assert_allclose(one.everything, whitened)


def test_an_arm_that_is_not_more_sensitive_keeps_its_weights() -> None:
    spec = mujoco.MjSpec.from_string(TWO_LINKS)
    first = start(ArmRollouts(spec, record(), np.full(2, 4e-4)))
    again = rewhiten(first)
    assert again.setting is first.setting
    assert again.sensitivity == pytest.approx(1.0)


@pytest.mark.thorough
def test_a_load_is_certain_though_the_unit_of_torques_is_not(tmp_path: Path) -> None:
    """All masses and the torque's factor may grow together: so may the load's torque.

    That is an uncertainty of its mass alone. Counted as sensitivity of the arm, it was
    24 times the tolerance before, and explained a load that is there ten times over.
    """
    path = tmp_path / "arm.xml"
    path.write_text(XML)
    before = record_torques(wrong_everywhere, seed=1)
    after = record_torques(wrong_everywhere, loaded_hand, seed=3)
    known = prepare(load_model(path), after, before, None, 1, lambda said, part: None)
    first = start(known.problem, spread=SPREAD)
    place = {"mass": 0.1, "x": 0.15, "y": 0.0, "z": 0.0}
    first, (found,) = first.fit([[AppliedEffect("payload", "lower", place)]])
    assert rewhiten(replace(first, best=found)).sensitivity < 2.0
