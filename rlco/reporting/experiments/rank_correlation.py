"""Spearman's rank correlation of two quantities over groups of runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from rlco.reporting.statistics import Interval

#: Fewest groups that an order can be told of.
LEAST_GROUPS = 3


class Runs(NamedTuple):
    """Two quantities of the runs of one group, paired by seed."""

    x: Sequence[float]
    y: Sequence[float]


def rank_correlation(
    groups: Sequence[Runs],
    *,
    confidence: float = 0.95,
    draws: int = 10_000,
    seed: int = 0,
) -> Interval:
    """Spearman's correlation of the groups' means, with a clustered bootstrap.

    Runs of one group are not independent of each other: a draw takes groups with
    replacement, then runs within each (Davison and Hinkley 1997, section 3.8). Equal
    means share their mean rank. Draws in which all groups came out equal in one
    quantity have no correlation and are left out.

    Args:
        groups: At least three, each with at least one run.
        confidence: Coverage of the percentile interval.
        draws: Of the bootstrap.
        seed: Of its random numbers.

    Raises:
        ValueError: Too few groups, runs that are not paired, or groups that are all
            equal in one quantity.

    Example:
        >>> rising = [Runs([0, 0.1], [0, 0]), Runs([0.4], [0.3]), Runs([1, 1], [2, 1])]
        >>> rank_correlation(rising).estimate
        1.0
    """
    if len(groups) < LEAST_GROUPS:
        raise ValueError(
            f"{len(groups)} groups; a rank correlation needs at least {LEAST_GROUPS}"
        )
    if any(len(x) != len(y) or not len(x) for x, y in groups):
        raise ValueError("every group needs as many x as y, and at least one")
    means = np.array([[np.mean(x), np.mean(y)] for x, y in groups])
    estimate = _spearman(means[None, :, 0], means[None, :, 1])[0]
    if np.isnan(estimate):
        raise ValueError("all groups are equal in one quantity: they have no order")
    rng = np.random.default_rng(seed)
    shape = (draws, len(groups))
    drawn = np.empty((*shape, 2))
    picked = rng.integers(len(groups), size=shape)
    for group, runs in enumerate(groups):
        here = picked == group
        size = (int(here.sum()), len(runs.x))
        again = rng.integers(len(runs.x), size=size)
        drawn[here] = np.array(runs)[:, again].mean(axis=2).T
    values = _spearman(drawn[..., 0], drawn[..., 1])
    tail = (1 - confidence) / 2
    low, high = np.quantile(values[~np.isnan(values)], [tail, 1 - tail])
    return Interval(float(estimate), float(low), float(high))


def _spearman(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the correlation of each row's ranks, nan where a row is constant."""
    from scipy import stats

    one, other = (stats.rankdata(values, axis=1) for values in (x, y))
    one -= one.mean(axis=1, keepdims=True)
    other -= other.mean(axis=1, keepdims=True)
    size = np.sqrt((one**2).sum(axis=1) * (other**2).sum(axis=1))
    product = (one * other).sum(axis=1)
    correlations = np.full(len(x), np.nan)
    np.divide(product, size, out=correlations, where=size > 0)
    return correlations
