"""Effects that are dropped: needless ones, and those that do not show."""

from __future__ import annotations

from dataclasses import replace

import pytest
from small_problems import Interruptible, arm_problem

from rlco.gap.search.state import State
from rlco.gap.search.steps.drop import drop, drop_unobservable
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

FRICTION = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.6})
NOTHING = AppliedEffect("viscous_damping", "shoulder", {"damping": 1e-5})


@pytest.fixture(scope="module")
def state() -> State:
    problem = arm_problem(FRICTION, recordings=3, seconds=2.0)
    return start(Interruptible(problem.log))


def with_best(state: State, *effects: AppliedEffect) -> State:
    state, (best,) = state.fit([effects])
    return replace(state, best=best)


def test_an_effect_that_the_others_make_up_for_is_dropped(state: State) -> None:
    both = with_best(state, FRICTION, NOTHING)
    after = drop(both)
    assert [e.name for e in after.best.effects] == ["coulomb_friction"]
    assert after.trail[-1] == {"effects": after.best.effects, "dropped": True}
    assert len(both.best.effects) == 2


def test_the_last_effect_is_never_dropped(state: State) -> None:
    one = with_best(state, FRICTION)
    assert drop(one) is one
    assert drop_unobservable(one) is one


def test_an_effect_that_does_not_show_by_itself_is_dropped(state: State) -> None:
    (scored,) = state.setting.score(
        [replace(state.best.fit, effects=(FRICTION, NOTHING))]
    )
    after = drop_unobservable(replace(state, best=scored))
    assert [e.name for e in after.best.effects] == ["coulomb_friction"]
