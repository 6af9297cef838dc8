"""Effects that are dropped: needless ones, and those that do not show."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from small_problems import Interruptible, arm_problem

from rlco.gap.search.state import State
from rlco.gap.search.steps.drop import VISIBLE, drop, drop_unobservable
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


def test_where_the_noise_was_observed_an_effect_need_show_in_one_joint_alone(
    state: State,
) -> None:
    weak = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.004})
    setting = state.setting
    one, none = setting.at_first.whiten(
        np.hstack(
            [
                setting.residuals([(weak,), ()], part)
                for part in (setting.train, setting.heldout)
            ]
        )
    )
    # Hardly anything at the elbow: of two joints, the mean is half the shoulder's.
    assert 0.5 * VISIBLE < np.mean((one - none) ** 2) < VISIBLE
    (scored,) = setting.score([replace(state.best.fit, effects=(FRICTION, weak))])
    unsure = replace(state, best=scored)
    problem = copy(setting.problem)
    problem.noise_was_observed = True
    sure = replace(unsure, setting=replace(setting, problem=problem))
    after = drop_unobservable(unsure)
    assert [e.name for e in after.best.effects] == ["coulomb_friction"]
    assert drop_unobservable(sure) is sure
