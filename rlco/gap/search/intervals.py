"""Intervals of fitted parameters that account for model uncertainty.

Two sources add up. Rows of a rollout are correlated, so the residual is resampled in
blocks of time instead of rows. And the model's own parameters have a tolerance: they
are free under their prior, which widens the intervals of the effect's parameters.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array

DRAWS = 400
COVERED = 0.90
NORMAL = 1.645  # standard deviations that cover as much of a normal distribution


def block_bootstrap(jacobian: Array, residual: Array, blocks: Integers) -> Array:
    """Return changes of the parameters under resampled blocks, (draws, parameters).

    Args:
        jacobian: Change of the whitened residual per unit of each parameter,
            (parameters, N).
        residual: The whitened residual of the best fit, (N,).
        blocks: Block of each row, (N,).
    """
    names, place = np.unique(blocks, return_inverse=True)
    order = np.argsort(place, kind="stable")
    bounds = np.searchsorted(place[order], np.arange(len(names) + 1))
    squares, gradients = [], []
    for first, last in pairwise(bounds):
        rows = order[first:last]
        squares.append(jacobian[:, rows] @ jacobian[:, rows].T)
        gradients.append(jacobian[:, rows] @ residual[rows])
    random = np.random.default_rng(0)
    counts = random.multinomial(len(names), np.full(len(names), 1 / len(names)), DRAWS)
    normal = np.einsum("db,bij->dij", counts, np.stack(squares))
    normal = normal + 1e-12 * np.trace(normal.mean(axis=0)) * np.eye(len(jacobian))
    gradient = counts @ (np.stack(gradients) - np.mean(gradients, axis=0))
    return np.asarray(-np.linalg.solve(normal, gradient[..., None])[..., 0])


def half_widths(
    jacobian: Array, residual: Array, blocks: Integers, free: Array
) -> tuple[Array, Array]:
    """Return half the width of each parameter's interval, and their correlations.

    Args:
        jacobian: Whitened, (parameters, N).
        residual: Whitened, (N,).
        blocks: Block of each row, (N,).
        free: As `jacobian`, whitened with the prior of the tolerance counted once,
            (parameters, N).

    Returns:
        The half widths, (parameters,), and the correlations, (parameters, parameters).

    Example:
        >>> free = np.array([[1.0, 0.0], [1.0, 2.0]])
        >>> exact = np.eye(2), np.zeros(2), np.arange(2)
        >>> widths, correlation = half_widths(*exact, free)
        >>> widths.round(2).tolist()  # 1.645 of the square roots of 5 / 4 and 1 / 4
        [1.84, 0.82]
        >>> round(float(correlation[0, 1]), 2)
        -0.45
    """
    draws = block_bootstrap(jacobian, residual, blocks)
    low, high = np.quantile(draws, [(1 - COVERED) / 2, (1 + COVERED) / 2], axis=0)
    resampled = (high - low) / 2
    normal = free @ free.T
    normal = normal + 1e-12 * np.trace(normal) * np.eye(len(normal))
    known = np.linalg.inv(normal)
    prior = NORMAL * np.sqrt(np.maximum(np.diag(known), 0.0))
    # The draws' tails are theirs, their directions those of their covariance.
    away = draws - draws.mean(axis=0)
    both = correlation_of(away.T @ away)
    covariance = both * np.outer(resampled, resampled)
    covariance += correlation_of(known) * np.outer(prior, prior)
    return np.asarray(np.hypot(resampled, prior)), correlation_of(covariance)


def correlation_of(covariance: Array) -> Array:
    """Return the correlations of a covariance; of what does not vary, none.

    Example:
        >>> correlation_of(np.array([[4.0, 3.0, 0.0], [3.0, 9.0, 0.0], [0.0] * 3]))
        array([[1. , 0.5, 0. ],
               [0.5, 1. , 0. ],
               [0. , 0. , 1. ]])
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size = np.where(size > 0.0, size, np.inf)
    found = np.clip(covariance / np.outer(size, size), -1.0, 1.0)
    np.fill_diagonal(found, 1.0)
    return np.asarray(found)
