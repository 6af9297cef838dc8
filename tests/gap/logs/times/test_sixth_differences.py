"""Sixth differences against fractions, whose products never leave their range."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from rlco.gap.logs.times.sixth_differences import sixth_differences


def exact(time: list[float], values: list[float]) -> float:
    """Return the divided difference of one window, scaled so that white noise keeps."""
    times = [Fraction(one) for one in time]
    weights = []
    for here in times:
        product = Fraction(1)
        for other in times:
            product *= here - other if here != other else 1
        weights.append(1 / product)
    largest = max(map(abs, weights))
    shares = np.array([float(weight / largest) for weight in weights])
    return float(shares @ values / np.linalg.norm(shares))


@pytest.mark.parametrize(
    "time",
    [
        [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        [0.0, 0.1, 0.3, 0.35, 0.7, 0.71, 2.0],
        # Products of six such gaps are smaller than any number, or larger.
        [0.0, 1e-80, 2e-80, 3e-80, 5e-80, 7e-80, 1.0],
        [0.0, 1e-300, 1.0, 1e10, 1e20, 1e29, 1e30],
    ],
)
def test_they_are_those_of_fractions_however_near_times_lie(time: list[float]) -> None:
    values = [1.0, -2.0, 0.5, 3.0, -1.0, 0.25, 2.0]
    high, _ = sixth_differences(np.array(time), np.array(values)[:, None])
    assert high.shape == (1, 1)
    assert high[0, 0] == pytest.approx(exact(time, values), rel=1e-9)
