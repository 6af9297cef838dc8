"""Intervals: of a success rate, of a mean over seeds, of a paired difference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, NotRequired, TypedDict

import numpy as np
import numpy.typing as npt

from rlco.errors import RlcoError

#: What two rows must have in common to have the same initial states, in pairs.
PAIRED_BY = ("task", "domain", "variation", "seed", "states_seed", "episodes")


class ResultRow(TypedDict):
    """One policy, evaluated: a row of ``results.json``.

    ``successes`` counts the episodes that were solved at their end, ``ever_successes``
    those that were solved after some decision, ``lost`` the latter without the former.
    ``outcomes`` and ``ever`` say the same of each episode, 0 or 1, in the order of the
    initial states, which ``states_seed`` draws. Rows of older files lack these five.
    ``look`` is there where images had another look than the domain's, ``renderer`` and
    ``guidance`` where a policy was given another one than it was saved with.
    """

    method: str
    task: str
    policy: str
    domain: str
    variation: str | None
    seed: int
    episodes: int
    successes: int
    ever_successes: NotRequired[int]
    lost: NotRequired[int]
    outcomes: NotRequired[list[int]]
    ever: NotRequired[list[int]]
    states_seed: NotRequired[int]
    look: NotRequired[str]
    renderer: NotRequired[str]
    guidance: NotRequired[float]


class ImitationRow(TypedDict):
    """One policy on one data set: an entry under ``imitation`` of ``results.json``.

    ``imitation_error`` is the policy's own imitation loss a control step.
    ``action_error`` is how far its most likely actions are from the demonstrated ones:
    the mean absolute difference of each action number, in the data's own unit.
    """

    method: str
    task: str | None
    policy: str
    seed: int
    data: str
    path: str
    frames: int
    imitation_error: float
    action_error: dict[str, float]


class Interval(NamedTuple):
    """An estimate and the ends of its confidence interval."""

    estimate: float
    low: float
    high: float


def wilson_interval(
    successes: int, episodes: int, confidence: float = 0.95
) -> Interval:
    """Wilson's score interval of a success rate (Wilson 1927, without correction).

    It stays within [0, 1] and keeps its coverage for few episodes and for rates
    near 0 and 1, where the textbook interval shrinks to a point.

    Args:
        successes: Episodes that succeeded.
        episodes: Episodes in all, at least 1.
        confidence: Coverage of the interval.

    Raises:
        ValueError: ``successes`` is not within 0 and ``episodes``, or no episodes.

    Example:
        >>> rate, low, high = wilson_interval(17, 20)
        >>> f"{rate:.2f} [{low:.2f}, {high:.2f}]"
        '0.85 [0.64, 0.95]'
    """
    if not 0 <= successes <= episodes or episodes < 1:
        raise ValueError(f"{successes} successes of {episodes} episodes")
    from scipy import stats  # a second, for what comes last

    interval = stats.binomtest(successes, episodes).proportion_ci(
        confidence, method="wilson"
    )
    return Interval(successes / episodes, float(interval.low), float(interval.high))


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> Interval:
    """Student's t interval of a mean over independent runs (seeds).

    mean +- t[n - 1] * s / sqrt(n), s the sample standard deviation. One value alone
    says nothing about its spread: the ends are nan.

    Raises:
        ValueError: No values.

    Example:
        >>> mean, low, high = mean_interval([0.7, 0.8, 0.9])
        >>> f"{mean:.2f} [{low:.2f}, {high:.2f}]"
        '0.80 [0.55, 1.05]'
    """
    if len(values) == 0:
        raise ValueError("a mean needs at least one value")
    mean = float(np.mean(values))
    if len(values) == 1:
        return Interval(mean, math.nan, math.nan)
    from scipy import stats

    error = float(np.std(values, ddof=1)) / math.sqrt(len(values))
    reach = float(stats.t.ppf((1 + confidence) / 2, len(values) - 1)) * error
    return Interval(mean, mean - reach, mean + reach)


def mean_of_means(
    groups: Sequence[Sequence[float]], confidence: float = 0.95
) -> Interval:
    """Mean of the means of several groups of independent runs, each counted alike.

    The groups may differ in size and spread. The variance of the mean is the sum of
    those of the groups' means over the squared number of groups; its degrees of freedom
    are Welch's and Satterthwaite's (Biometrics Bulletin 2, 1946). Of a group with one
    run nothing is known of its spread: the ends are nan.

    Raises:
        ValueError: No groups, or one without a run.

    Example:
        >>> mean, low, high = mean_of_means([[0.1, 0.3], [0.5, 0.7, 0.9]])
        >>> f"{mean:.2f} [{low:.2f}, {high:.2f}]"
        '0.45 [0.20, 0.70]'
    """
    if not groups or any(len(group) == 0 for group in groups):
        raise ValueError("a mean of means needs a run in each group")
    mean = float(np.mean([np.mean(group) for group in groups]))
    if any(len(group) == 1 for group in groups):
        return Interval(mean, math.nan, math.nan)
    from scipy import stats

    variances = np.array([np.var(group, ddof=1) / len(group) for group in groups])
    if not variances.any():
        return Interval(mean, mean, mean)
    within = np.array([len(group) - 1 for group in groups])
    freedom = variances.sum() ** 2 / np.sum(variances**2 / within)
    error = math.sqrt(variances.sum()) / len(groups)
    reach = float(stats.t.ppf((1 + confidence) / 2, freedom)) * error
    return Interval(mean, mean - reach, mean + reach)


def rate_interval(rows: Sequence[ResultRow], confidence: float = 0.95) -> Interval:
    """Success rate of one method in one place, with its interval.

    One row: Wilson's interval over its episodes. Several (seeds): the mean of their
    rates with Student's t interval, because episodes of one seed share a policy.

    Raises:
        ValueError: No rows.
    """
    if len(rows) == 1:
        return wilson_interval(rows[0]["successes"], rows[0]["episodes"], confidence)
    return mean_interval(
        [row["successes"] / row["episodes"] for row in rows], confidence
    )


def paired_difference(
    first: Sequence[bool], second: Sequence[bool], confidence: float = 0.95
) -> Interval:
    """Difference of two success rates over the same initial states, first - second.

    Newcombe's interval from the two Wilson intervals and the correlation of the
    outcomes (Newcombe 1998, method 10). Like McNemar's test it uses the pairing;
    it also stays sensible where the two never disagree.

    Args:
        first: Success of one policy in each initial state. Shape (n,).
        second: Success of the other in the same states. Shape (n,).
        confidence: Coverage of the interval.

    Raises:
        ValueError: The two are empty or differ in length.

    Example:
        >>> gain = paired_difference([True] * 9 + [False], [True] * 4 + [False] * 6)
        >>> f"{gain.estimate:+.2f} [{gain.low:+.2f}, {gain.high:+.2f}]"
        '+0.50 [+0.08, +0.75]'
    """
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    if a.shape != b.shape or a.size == 0:
        raise ValueError(f"{a.size} outcomes cannot be paired with {b.size}")
    n = a.size
    p, q = (wilson_interval(int(x.sum()), n, confidence) for x in (a, b))
    phi = _correlation(a, b)
    down_p, up_p = p.estimate - p.low, p.high - p.estimate
    down_q, up_q = q.estimate - q.low, q.high - q.estimate
    # The law of cosines: distances of correlated estimates subtract in part.
    below = math.sqrt(down_p**2 - 2 * phi * down_p * up_q + up_q**2)
    above = math.sqrt(up_p**2 - 2 * phi * up_p * down_q + down_q**2)
    difference = p.estimate - q.estimate
    return Interval(difference, difference - below, difference + above)


def paired_rows(
    first: ResultRow, second: ResultRow, confidence: float = 0.95
) -> Interval:
    """Difference of two methods' success at the end within one seed, first - second.

    See `paired_difference`. It holds for these two policies, not for two methods.

    Raises:
        RlcoError: The rows have other initial states, or no outcomes per episode.
    """
    check_paired(first, second)
    one, other = ([bool(o) for o in row["outcomes"]] for row in (first, second))
    return paired_difference(one, other, confidence)


def paired_over_seeds(
    first: Sequence[ResultRow], second: Sequence[ResultRow], confidence: float = 0.95
) -> Interval:
    """Mean over seeds of two methods' difference of success at the end.

    Within a seed both methods have the same initial states and demonstrations; the
    seeds are the independent runs, so the interval is Student's t over the seeds'
    differences, see `mean_interval`.

    Args:
        first: One row per seed.
        second: The other method's, for the same seeds in any order.
        confidence: Coverage of the interval.

    Raises:
        RlcoError: The two have other seeds, a seed twice, or rows that `paired_rows`
            refuses.
        ValueError: No rows.

    Example:
        >>> def row(seed, outcomes):
        ...     return dict(
        ...         method="m", task="t", domain="sim", variation=None, seed=seed,
        ...         episodes=4, outcomes=outcomes)
        >>> one = [row(0, [1, 1, 1, 0]), row(1, [1, 1, 0, 0])]
        >>> other = [row(1, [1, 0, 0, 0]), row(0, [0, 1, 0, 0])]
        >>> paired_over_seeds(one, other).estimate
        0.375
    """
    partners = {row["seed"]: row for row in second}
    given = [sorted(row["seed"] for row in rows) for rows in (first, second)]
    if given[0] != given[1] or len(partners) != len(second):
        raise RlcoError(
            f"seeds {given[0]} cannot be paired with seeds {given[1]}; give one row of "
            "each method per seed."
        )
    differences = []
    for row in first:
        partner = partners[row["seed"]]
        check_paired(row, partner)
        one, other = (float(np.mean(r["outcomes"])) for r in (row, partner))
        differences.append(one - other)
    return mean_interval(differences, confidence)


def check_paired(first: ResultRow, second: ResultRow) -> None:
    """Refuse two rows whose episodes did not start from the same initial states.

    Raises:
        RlcoError: They differ in what draws the initial states or in where they were
            played, or have no outcomes per episode.
    """
    pair = f"{first['method']} and {second['method']} cannot be paired"
    for name in PAIRED_BY:
        one, other = first.get(name), second.get(name)
        if one != other:
            raise RlcoError(
                f"{pair}: {name} is {one!r} and {other!r}; evaluate both from the same "
                "initial states, in the same task and domain."
            )
    for row in (first, second):
        if len(row.get("outcomes", ())) != row["episodes"]:
            raise RlcoError(
                f"{pair}: the row of {row['method']} does not hold one outcome per "
                "episode, as those of older results.json; evaluate it again."
            )


def _correlation(a: npt.NDArray[np.bool_], b: npt.NDArray[np.bool_]) -> float:
    """Phi coefficient of two sets of outcomes, with Newcombe's continuity term."""
    n = a.size
    both, neither = int((a & b).sum()), int((~a & ~b).sum())
    only_a, only_b = int((a & ~b).sum()), int((~a & b).sum())
    product = int(a.sum()) * int((~a).sum()) * int(b.sum()) * int((~b).sum())
    if product == 0:
        return 0.0
    excess: float = both * neither - only_a * only_b
    if excess > 0:
        excess = max(excess - n / 2, 0)
    return float(excess / math.sqrt(product))
