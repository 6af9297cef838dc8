"""What a screening makes of an effect: the numbers that a fit starts from."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.screening import Screening, explained, start_of
from rlco.physics.effects.effect import Parameter

_SPRING = Candidate("joint_stiffness", "elbow")
_KNOWN = (
    Parameter("stiffness", "N m/rad", 0.0, 50.0, 0.0, (2.0,)),
    Parameter("reference", "rad", -3.0, 3.0, 0.0, (0.5,)),
)


@pytest.mark.parametrize(
    ("residual", "stiffness"),
    [
        ([-3.0, 1.0], 6.0),  # three times the change that was looked at takes it away
        ([-9.0, 1.0], 6.0),  # a line from so near is not to be trusted further
        ([-0.02, 1.0], 0.1),  # hardly any: still enough to tell what a reference does
        ([3.0, 1.0], 0.1),  # a negative one, which there is not
    ],
)
def test_a_fit_starts_where_the_effect_does_something(
    residual: list[float], stiffness: float
) -> None:
    first: NDArray[np.float64] = np.array([1.0, 0.0])
    one = Screening(
        _SPRING, np.array([2.0, 0.5]), np.zeros(2), first[None], first, one_sided=True
    )
    (effect,) = start_of({_SPRING: _KNOWN}, one, np.array(residual))
    np.testing.assert_allclose(effect.values, [stiffness, 0.5])


def test_a_small_help_of_a_negative_amount_stays_negative() -> None:
    bias = Candidate("torque_bias", "elbow")
    known = (Parameter("torque", "N m", -5.0, 5.0, 0.0, (2.0,)),)
    first: NDArray[np.float64] = np.array([1.0, 0.0])
    one = Screening(
        bias, np.array([2.0]), np.zeros(1), first[None], first, one_sided=False
    )
    (effect,) = start_of({bias: known}, one, np.array([0.03, 1.0]))
    np.testing.assert_allclose(effect.values, [-0.1])


@pytest.mark.parametrize(("residual", "less"), [([-4.0, 2.0], 8.0), ([4.0, 2.0], 0.0)])
def test_what_only_a_negative_friction_would_explain_is_not_explained(
    residual: list[float], less: float
) -> None:
    first: NDArray[np.float64] = np.array([1.0, 0.0])
    friction = Candidate("coulomb_friction", "elbow")
    one = Screening(
        friction, np.ones(1), np.zeros(1), first[None], first, one_sided=True
    )
    # Of the mean square of the residual, 10, what goes with the friction is 8.
    assert explained(one, np.array(residual), np.zeros((0, 2))) == pytest.approx(less)
