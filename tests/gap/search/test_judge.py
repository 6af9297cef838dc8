"""When a number counts as having run to its bounds, and when an effect is worth it."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from small_problems import arm_problem

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.find_gap import find_gap
from rlco.gap.search.judge import at_bounds, gain, is_worth_it, kind
from rlco.gap.search.setting import Scored
from rlco.gap.search.state import State
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect, Parameter

# As of a motor of 6.2 N m: limits up to a hundred times that are bounds, not guesses.
LIMIT = Parameter("limit", "N m", 0.12, 620.0, 620.0, (0.5, 2.0, 6.2), False)


def found(limit: float) -> bool:
    library = {Candidate("torque_limit", "elbow"): (LIMIT,)}
    effects = (AppliedEffect("torque_limit", "elbow", {"limit": limit}),)
    return at_bounds(library, effects)


@pytest.mark.parametrize("limit", [0.36, 0.2, 6.0, 300.0])
def test_a_small_limit_is_not_at_the_bounds_of_a_wide_range(limit: float) -> None:
    assert not found(limit)


@pytest.mark.parametrize("limit", [0.12, 0.1201])
def test_a_number_that_ran_into_its_lower_bound_is_there(limit: float) -> None:
    assert found(limit)


def test_a_number_that_stayed_neutral_is_not_there() -> None:
    assert not found(620.0)


SMALL = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.005})


def with_errors(state: State, shoulder: float, elbow: float) -> Scored:
    """Return a fit whose whitened residual has the same size in all rows of a joint."""
    part = state.setting.series % 2
    return replace(state.none, everything=np.where(part == 0, shoulder, elbow))


@pytest.fixture(scope="module")
def quiet() -> State:
    return start(arm_problem(recordings=3, seconds=4.0))


def observed_before(state: State, inexact: float = 0.0) -> State:
    problem = copy(state.setting.problem)
    problem.noise_was_observed, problem.inexact = True, inexact
    return replace(state, setting=replace(state.setting, problem=problem))


def test_where_the_noise_was_observed_the_joint_that_gains_most_counts(
    quiet: State,
) -> None:
    none, one = with_errors(quiet, 1.0, 1.0), with_errors(quiet, 1.0, 0.9)
    whole = 1.0 - np.sqrt((1.0 + 0.81) / 2.0)
    assert gain(quiet, one, none) == pytest.approx(whole)
    assert gain(observed_before(quiet), one, none) == pytest.approx(0.1)


def test_what_a_comparison_may_get_wrong_of_one_effect_is_no_second(
    quiet: State,
) -> None:
    state = replace(
        observed_before(quiet, inexact=0.02),
        scores={frozenset(): with_errors(quiet, 20.0, 1.0)},
    )
    first = with_errors(state, 2.6, 1.0)  # 400 - 6.76 explained: 2 % are 7.9
    assert gain(state, with_errors(state, 1.5, 1.0), first) == 0.0
    # Nothing was explained at the elbow: there a second is none of the first's error.
    second = with_errors(state, 1.5, 0.95)
    assert gain(state, second, first) == pytest.approx(0.05)


def test_a_joint_without_any_residual_gains_nothing(quiet: State) -> None:
    state = observed_before(quiet)
    exact, other = with_errors(quiet, 0.0, 1.0), with_errors(quiet, 0.0, 0.9)
    assert gain(state, other, exact) == pytest.approx(0.1)
    assert gain(state, exact, exact) == 0.0


def in_two_seconds(state: State, size: float) -> Scored:
    """Return a fit that leaves so much in two held-out seconds, and noise elsewhere."""
    blocks = state.setting.blocks
    rows = np.isin(blocks, np.unique(blocks)[-2:])
    noise = np.random.default_rng(0).standard_normal(len(blocks))
    return replace(state.none, everything=np.where(rows, size, 1.0) * noise)


def test_a_few_seconds_decide_only_where_an_effect_explains_much(quiet: State) -> None:
    state = observed_before(quiet)
    little, much = in_two_seconds(quiet, 1.3), in_two_seconds(quiet, 10.0)
    other = in_two_seconds(quiet, 1.0)
    assert state.setting.better(other, little)
    assert not is_worth_it(state, other, little)
    assert is_worth_it(state, other, much)
    # In one log alone, whose noise is not known joint by joint, either test decides.
    assert is_worth_it(quiet, other, little)


def test_what_helps_no_joint_in_held_out_recordings_is_not_named(quiet: State) -> None:
    fit = replace(quiet.none.fit, effects=(SMALL,))
    training = len(quiet.none.fit.residual)

    def named(heldout: float) -> bool:
        everything = np.full(len(quiet.setting.series), 0.5)
        everything[training:] = np.where(
            quiet.setting.series[training:] % 2, heldout, 1.0
        )
        none = {frozenset(): with_errors(quiet, 1.0, 1.0)}
        best = replace(quiet.none, fit=fit, everything=everything)
        return kind(replace(observed_before(quiet), scores=none, best=best)) == "named"

    assert named(0.97)
    assert not named(0.995)


def test_a_small_friction_is_named_only_where_the_noise_was_observed() -> None:
    problem = arm_problem(SMALL, recordings=6, seconds=4.0)
    assert not find_gap(problem).effects
    problem.noise_was_observed = True
    (named,) = find_gap(problem).effects
    assert (named.name, named.target) == ("coulomb_friction", "elbow")
    assert named.parameters["frictionloss"].value == pytest.approx(0.005, rel=0.3)
