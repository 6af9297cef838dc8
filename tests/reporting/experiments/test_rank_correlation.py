"""Rank correlations over groups of runs."""

import numpy as np
import pytest
from scipy import stats

from rlco.reporting.experiments.prediction_figure import prediction_figure
from rlco.reporting.experiments.rank_correlation import Runs, rank_correlation


def groups_of(seed: int, count: int, slope: float) -> list[Runs]:
    rng = np.random.default_rng(seed)
    base = rng.uniform(size=count)
    return [
        Runs(b + 0.05 * rng.normal(size=5), slope * b + 0.05 * rng.normal(size=5))
        for b in base
    ]


def test_the_estimate_is_spearmans_of_the_means() -> None:
    groups = groups_of(0, 9, -0.1)
    means = [[np.mean(g.x), np.mean(g.y)] for g in groups]
    expected = stats.spearmanr(*np.transpose(means)).statistic
    assert rank_correlation(groups).estimate == pytest.approx(expected)


def test_a_steep_fall_is_confirmed_and_no_relation_is_not() -> None:
    falls = rank_correlation(groups_of(1, 12, -2.0))
    assert falls.high < -0.8
    unrelated = rank_correlation(groups_of(2, 8, 0.0))
    assert unrelated.low < 0 < unrelated.high


def test_groups_and_not_runs_make_the_interval_narrow() -> None:
    few = groups_of(3, 6, -0.2)
    copied = [Runs([*g.x] * 20, [*g.y] * 20) for g in few]  # no further group
    one, other = rank_correlation(few), rank_correlation(copied)
    assert other.high - other.low > 0.5 * (one.high - one.low)


def test_equal_groups_have_no_order() -> None:
    with pytest.raises(ValueError, match="no order"):
        rank_correlation([Runs([0.5], [k]) for k in range(4)])
    with pytest.raises(ValueError, match="at least 3"):
        rank_correlation([Runs([0.5], [1])] * 2)


def test_the_figure_sorts_groups_by_success() -> None:
    groups = {
        "far": Runs([0.1, 0.2], [0.3, 0.3]),
        "near": Runs([0.9, 0.8], [0.0, -0.1]),
    }
    figure = prediction_figure(groups, ("beta 1", "beta 0"), "sim_only", "stand_in")
    left, right = figure.axes
    assert [label.get_text() for label in left.get_yticklabels()] == ["far", "near"]
    assert right.get_xlabel() == "beta 1 - beta 0 [points]"
    gains = [bar[0].get_xdata()[0] for bar in right.containers]
    assert gains == pytest.approx([30.0, -5.0])
