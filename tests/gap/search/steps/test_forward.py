"""One round of a search, step by step, on a small arm."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from small_problems import Interruptible, arm_problem

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.state import State
from rlco.gap.search.steps.forward import forward, screen, shortlist, swap, take
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

FRICTION = AppliedEffect("coulomb_friction", "shoulder", {"frictionloss": 0.6})
DAMPING = AppliedEffect("viscous_damping", "elbow", {"damping": 0.6})
NAMES = {Candidate(e.name, e.target) for e in (FRICTION, DAMPING)}


@pytest.fixture(scope="module")
def state() -> State:
    problem = arm_problem(FRICTION, DAMPING, recordings=3, seconds=2.0)
    return start(Interruptible(problem.log))


@pytest.fixture(scope="module")
def screened(state: State) -> State:
    return screen(shortlist(state))


def test_a_search_begins_with_the_model_as_it_is(state: State) -> None:
    assert not state.best.effects
    assert state.setting.heldout == (2,)
    assert state.scores == {frozenset(): state.best}


def test_screening_simulates_each_candidate_of_the_list(
    state: State, screened: State
) -> None:
    listed = shortlist(state).round
    assert listed is not None
    assert set(listed.candidates) == set(state.setting.library)
    assert {one.candidate for one in screened.screenings} == set(listed.candidates)
    assert screened.visible
    assert not state.screenings  # what was given is as it was


def test_a_joint_that_is_explained_stays_listed_only_where_the_noise_was_observed(
    state: State,
) -> None:
    setting = state.setting
    near = np.isin(setting.problem.layout.recording, setting.train)
    shoulder = setting.problem.layout.channel[near] == 0
    left = np.where(shoulder, 10.0, 1.0)  # in units of the noise
    best = replace(state.best.fit, effects=(DAMPING,), residual=left)
    explained = replace(state, best=replace(state.best, fit=best))
    problem = copy(setting.problem)
    problem.noise_was_observed = True
    observed = replace(explained, setting=replace(setting, problem=problem))

    def listed(at: State) -> set[str | None]:
        found = shortlist(at).round
        assert found is not None
        return {one.target for one in found.candidates}

    assert listed(explained) == {"shoulder"}
    assert listed(observed) == {"shoulder", "elbow"}


def test_a_forward_step_fits_and_names_nothing_yet(screened: State) -> None:
    after = forward(screened)
    assert after.round is not None
    fitted = [set(one.names) for one in after.round.options]
    assert any(names < NAMES for names in fitted)
    assert all(len(names) == 1 for names in fitted)
    assert after.best is screened.best
    assert len(screened.scores) == 1


def test_what_explains_most_is_taken_and_fitted_to_the_end(screened: State) -> None:
    fitted = forward(screened)
    after = take(fitted)
    (name,) = after.best.names
    assert name in NAMES
    assert fitted.round is not None
    assert after.best.fit.cost <= min(one.fit.cost for one in fitted.round.options)
    assert after.trail[-1]["taken"]
    assert after.round is None
    assert not after.ended


def test_a_round_without_a_better_option_ends_the_search(screened: State) -> None:
    assert screened.round is not None
    empty = replace(screened, round=replace(screened.round, options=()))
    after = take(empty)
    assert after.ended
    assert after.best is screened.best


def test_an_effect_that_stood_in_for_another_is_swapped_for_it(state: State) -> None:
    other = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.3})
    fitted, (wrong,) = state.fit([[other]])
    listed = forward(screen(shortlist(replace(fitted, best=wrong))))
    assert listed.round is not None
    assert NAMES not in [set(one.names) for one in listed.round.options]
    swapped = swap(listed)
    assert swapped.round is not None
    best = min(swapped.round.options, key=lambda one: one.fit.cost)
    assert best.names == NAMES


def test_a_step_of_a_round_says_that_none_is_under_way(state: State) -> None:
    with pytest.raises(ValueError, match="shortlist"):
        screen(state)
