"""Decide which of two explanations is better, and whether significantly.

Residuals of rollouts are correlated over about a second, so tests that count rows would
find everything significant. Two tests allow for this; either is sufficient:

- Squared residuals are summed over blocks of time. The differences between blocks give
  the mean difference and its standard error (the test of Vuong 1989 for non-nested
  models, on blocks). It needs no noise model, but many blocks in which the two differ.
- The likelihood ratio is divided by its standard deviation under the hypothesis that
  the better residual r is noise. With the other residual r + d it is
  sum d^2 + 2 sum r d, with standard deviation 2 |d| times the size of r, increased by
  the correlation of r. This can reveal an effect that acts in one second of a minute,
  such as a limit that is rarely reached.
"""

from __future__ import annotations

import numpy as np

from rlco.gap.compare.problem import Integers, Layout
from rlco.gap.logs.log import Array

DOUBT = 3.0  # standard errors between blocks
SURE = 4.0  # standard errors of the likelihood ratio


def seconds_of(layout: Layout) -> Integers:
    """Return the block of time of each residual: its second of its recording, (N,)."""
    return np.asarray(layout.recording * 10_000 + layout.time.astype(np.int64))


def block_sums(values: Array, blocks: Integers) -> Array:
    """Return the sum of values in each block, (blocks,).

    Example:
        >>> block_sums(np.array([1.0, 2.0, 4.0]), np.array([7, 7, 9]))
        array([3., 4.])
    """
    _, place = np.unique(blocks, return_inverse=True)
    return np.asarray(np.bincount(place, weights=values), dtype=float)


def block_test(one: Array, other: Array, blocks: Integers) -> float:
    """Return by how many standard errors, over blocks, one residual is smaller.

    Args:
        one: A residual, (N,).
        other: Another of the same data, (N,).
        blocks: The block of time of each value, (N,).
    """
    gain = block_sums(other**2 - one**2, blocks)
    error = float(gain.std(ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else np.inf
    return float(gain.mean()) / max(error, 1e-300)


def correlation_length(residual: Array, series: Integers) -> float:
    """Return the correlation length of a residual in rows, at least 1.

    Args:
        residual: (N,).
        series: Block and channel of each value: neighbours share it, (N,).
    """
    sums, squares = block_sums(residual, series), block_sums(residual**2, series)
    return max(1.0, float((sums**2).sum() / max(float(squares.sum()), 1e-300)))


def likelihood_test(one: Array, other: Array, series: Integers) -> float:
    """Return the likelihood ratio of two residuals in standard errors, with its sign.

    Args:
        one: A residual in units of the noise, (N,).
        other: Another of the same data, (N,).
        series: Block and channel of each value, (N,).
    """
    gain = float((other**2).sum() - (one**2).sum())
    excess = max(1.0, float(np.mean(one**2)))
    scale = excess * correlation_length(one, series)
    apart = float(((other - one) ** 2).sum())
    return gain / max(2.0 * float(np.sqrt(apart * scale)), 1e-300)


def clearly_better(
    one: Array, other: Array, blocks: Integers, series: Integers
) -> bool:
    """Return whether one residual is significantly smaller by one of two tests."""
    if block_test(one, other, blocks) > DOUBT:
        return True
    return likelihood_test(one, other, series) > SURE


def better_by_both(
    one: Array, other: Array, blocks: Integers, series: Integers
) -> bool:
    """Return whether one residual is significantly smaller by both tests."""
    if block_test(one, other, blocks) <= DOUBT:
        return False
    return likelihood_test(one, other, series) > SURE
