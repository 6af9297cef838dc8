"""When a number of an effect counts as having run to its bounds."""

from __future__ import annotations

import pytest

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.judge import at_bounds
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
