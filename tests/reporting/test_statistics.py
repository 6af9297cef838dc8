"""Intervals against numbers worked out by hand."""

from __future__ import annotations

import math
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rlco.errors import RlcoError
from rlco.reporting.statistics import (
    ResultRow,
    mean_interval,
    paired_difference,
    paired_over_seeds,
    paired_rows,
    wilson_interval,
)


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


# -- Rows of results.json ----------------------------------------------------------


def result(method: str, seed: int, solved: list[int], **other: Any) -> ResultRow:
    row = {
        "method": method,
        "task": "push_cube",
        "policy": "gaussian",
        "domain": "sim",
        "variation": None,
        "seed": seed,
        "episodes": len(solved),
        "successes": sum(solved),
        "outcomes": solved,
        "states_seed": 1_000_004 + seed,
    }
    return cast("ResultRow", row | other)


def test_rows_of_one_seed_are_paired_by_their_initial_states() -> None:
    first, second = outcomes(4, 5, 0, 1)
    one, other = ([int(o) for o in both] for both in (first, second))
    found = paired_rows(result("rl_co", 0, one), result("sft", 0, other))
    assert found == paired_difference(first, second)
    # In another order of the states the same counts say something else.
    turned = paired_rows(result("rl_co", 0, one), result("sft", 0, other[::-1]))
    assert turned.estimate == found.estimate
    assert turned.low != found.low


def test_a_difference_over_seeds_by_hand() -> None:
    # Differences of the seeds: 3/4 - 1/4 = .5, 2/4 - 1/4 = .25, 1/4 - 2/4 = -.25
    # mean 1/6; s^2 = ((1/3)^2 + (1/12)^2 + (5/12)^2) / 2 = 42/288 = .1458333
    # t(.975, 2 d.o.f.) = 4.302653; reach = 4.302653 * .381881 / sqrt(3) = .948645
    rl_co = [
        result("rl_co", 10, [1, 1, 1, 0]),
        result("rl_co", 11, [1, 1, 0, 0]),
        result("rl_co", 12, [1, 0, 0, 0]),
    ]
    sft = [
        result("sft", 12, [0, 1, 0, 1]),
        result("sft", 10, [0, 1, 0, 0]),
        result("sft", 11, [0, 0, 0, 1]),
    ]
    found = paired_over_seeds(rl_co, sft)
    assert found == pytest.approx((1 / 6, 1 / 6 - 0.948645, 1 / 6 + 0.948645), abs=1e-6)
    # One seed has no spread.
    assert math.isnan(paired_over_seeds(rl_co[:1], sft[1:2]).low)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("task", "open_drawer"),
        ("domain", "stand_in"),
        ("variation", "camera"),
        ("states_seed", 1_000_003),
    ],
)
def test_rows_with_other_initial_states_are_not_paired(name: str, value: Any) -> None:
    one, other = result("rl_co", 0, [1, 0]), result("sft", 0, [1, 0], **{name: value})
    with pytest.raises(RlcoError, match=rf"rl_co and sft .* {name} is .*{value!r}"):
        paired_rows(one, other)
    with pytest.raises(RlcoError, match=f"{name} is"):
        paired_over_seeds([one], [other])


def test_rows_of_other_seeds_or_lengths_or_without_outcomes_are_not_paired() -> None:
    one = result("rl_co", 0, [1, 0])
    with pytest.raises(RlcoError, match="seed is 0 and 1"):
        paired_rows(one, result("sft", 1, [1, 0]))
    with pytest.raises(RlcoError, match="episodes is 2 and 3"):
        paired_rows(one, result("sft", 0, [1, 0, 0]))
    old = result("sft", 0, [1, 0])
    del old["outcomes"]
    with pytest.raises(RlcoError, match="row of sft does not hold one outcome per"):
        paired_rows(one, old)
    for others in ([1], [0, 0], [0, 1]):
        rows = [result("sft", seed, [1, 0]) for seed in others]
        with pytest.raises(RlcoError, match=r"seeds \[0\] cannot be paired with"):
            paired_over_seeds([one], rows)
    twice = [one, one]
    with pytest.raises(RlcoError, match=r"seeds \[0, 0\] cannot be paired"):
        paired_over_seeds(twice, twice)
