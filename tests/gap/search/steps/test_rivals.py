"""Others in the place of what was named, as a step of its own."""

from __future__ import annotations

from dataclasses import replace

import pytest
from small_problems import Interruptible, arm_problem

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.state import State
from rlco.gap.search.steps.rivals import rivals
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

FRICTION = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.6})
DAMPING = AppliedEffect("viscous_damping", "elbow", {"damping": 0.6})


@pytest.fixture(scope="module")
def state() -> State:
    problem = arm_problem(FRICTION, recordings=3, seconds=2.0)
    return start(Interruptible(problem.log))


def with_best(state: State, effect: AppliedEffect) -> State:
    state, (best,) = state.fit([[effect]])
    return replace(state, best=best)


def test_a_rival_that_does_worse_is_evidence_and_no_rival(state: State) -> None:
    tried, _ = state.fit([[DAMPING]])
    (found,) = rivals(with_best(tried, FRICTION)).rivals
    assert found.as_good == ()
    assert found.evidence["viscous_damping elbow"] > 0.1


def test_a_rival_that_does_better_takes_the_place(state: State) -> None:
    wrong = with_best(state, DAMPING)
    after = rivals(wrong)
    assert after.best.names == {Candidate("coulomb_friction", "elbow")}
    assert wrong.best.names == {Candidate("viscous_damping", "elbow")}


def test_where_nothing_is_named_there_are_no_rivals(state: State) -> None:
    assert rivals(state) is state
