"""Intervals against numbers worked out by hand."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rlco.reporting.statistics import mean_interval, paired_difference, wilson_interval


def test_wilson_interval_by_hand() -> None:
    # n = 20, k = 17, z = 1.959964: z^2 = 3.841459
    # centre = (17 + z^2/2) / (20 + z^2)            = 18.920729 / 23.841459 = 0.793606
    # reach  = z sqrt(17*3/20 + z^2/4) / (20 + z^2) = z sqrt(3.510365) / 23.841459
    #        = 1.959964 * 1.873597 / 23.841459      = 0.154024
    rate, low, high = wilson_interval(17, 20)
    assert rate == 0.85
    assert low == pytest.approx(0.793606 - 0.154024, abs=2e-6)
    assert high == pytest.approx(0.793606 + 0.154024, abs=2e-6)


def test_wilson_interval_keeps_width_at_the_ends() -> None:
    # k = 0: [0, z^2 / (n + z^2)] = [0, 3.841459 / 13.841459]
    assert wilson_interval(0, 10).low == pytest.approx(0, abs=1e-12)
    assert wilson_interval(0, 10).high == pytest.approx(0.277533, abs=1e-6)
    assert wilson_interval(10, 10).low == pytest.approx(1 - 0.277533, abs=1e-6)


@pytest.mark.parametrize(("successes", "episodes"), [(3, 2), (-1, 2), (0, 0)])
def test_impossible_counts_are_refused(successes: int, episodes: int) -> None:
    with pytest.raises(ValueError, match=f"{successes} successes of {episodes}"):
        wilson_interval(successes, episodes)


def test_mean_interval_by_hand() -> None:
    # mean 0.8; s = sqrt((0.1^2 + 0 + 0.1^2) / 2) = 0.1; t(0.975, 2 d.o.f.) = 4.302653
    # reach = 4.302653 * 0.1 / sqrt(3) = 0.248414
    mean, low, high = mean_interval([0.7, 0.8, 0.9])
    assert mean == pytest.approx(0.8)
    assert (low, high) == pytest.approx((0.551586, 1.048414), abs=1e-6)


def test_one_seed_has_no_spread() -> None:
    mean, low, high = mean_interval([0.7])
    assert mean == 0.7
    assert math.isnan(low)
    assert math.isnan(high)
    with pytest.raises(ValueError, match="at least one"):
        mean_interval([])


def outcomes(both: int, first: int, second: int, neither: int) -> tuple:
    a = [True] * (both + first) + [False] * (second + neither)
    b = [True] * both + [False] * first + [True] * second + [False] * neither
    return a, b


def test_paired_difference_by_hand() -> None:
    # 10 states: both 4, only the first 5, only the second 0, neither 1; p=.9, q=.4
    # Wilson 9/10: [.595850, .982124]; 4/10: [.168180, .687326]
    # phi: 4*1 - 5*0 = 4, less n/2 = 5: 0
    # below = sqrt(.304150^2 + .287326^2) = .418406
    # above = sqrt(.082124^2 + .231820^2) = .245937
    gain = paired_difference(*outcomes(4, 5, 0, 1))
    assert gain == pytest.approx((0.5, 0.081594, 0.745937), abs=2e-6)


def test_agreement_narrows_the_paired_interval() -> None:
    # The same rates, 30 and 20 of 50: once nested, once as independent as can be.
    nested = paired_difference(*outcomes(20, 10, 0, 20))
    crossed = paired_difference(*outcomes(12, 18, 8, 12))
    assert nested.estimate == crossed.estimate == pytest.approx(0.2)
    assert nested.high - nested.low < 0.8 * (crossed.high - crossed.low)
    # phi of nested: (20*20 - 25) / sqrt(30*20*20*30) = 375 / 600 = 0.625
    p, q = wilson_interval(30, 50), wilson_interval(20, 50)
    down, up = 0.6 - p.low, q.high - 0.4
    below = math.sqrt(down**2 - 2 * 0.625 * down * up + up**2)
    assert nested.low == pytest.approx(0.2 - below)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_swapping_the_two_mirrors_the_interval(pairs: list[tuple[bool, bool]]) -> None:
    first, second = zip(*pairs, strict=True)
    there, back = paired_difference(first, second), paired_difference(second, first)
    assert there == pytest.approx((-back.estimate, -back.high, -back.low), abs=1e-12)
    assert -1 - 1e-9 <= there.low <= there.estimate <= there.high <= 1 + 1e-9


def test_unequal_numbers_of_outcomes_cannot_be_paired() -> None:
    with pytest.raises(ValueError, match="3 outcomes cannot be paired with 2"):
        paired_difference([True] * 3, [True] * 2)
