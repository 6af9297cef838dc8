"""Likelihood of commands that arrive late at random, beside other disturbances.

Held against it, on recordings that were not fitted, are larger noise of each joint,
times that differ between joints, which stand for whatever else disturbs single joints
while they move, and times of the rows instead of the commands, which disturb all joints
too but are forgotten with the row. Each may have numbers of the model a little off
besides: their amounts are marginalised, with the priors that their columns contain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

from rlco.gap.compare.arm.commands.late import Responses
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array

_SPREADS = (3e-4, 0.2)  # that are searched [s]
_NOISES = (0.7, 30.0)  # times the noise that a joint may have
_CURVED = 0.05  # relative change of a spread that its interval is from


@dataclass(frozen=True)
class Lateness:
    """Estimated times of a log's commands.

    Attributes:
        problem: The problem as logged.
        late: Of each recording, how much later than its row, and than the mean, each
            command took effect, (rows,) [s].
        spread: Standard deviation of these times [s].
        width: Half the width of its 90 % interval [s].
    """

    problem: ArmRollouts
    late: Sequence[Array]
    spread: float
    width: float


@dataclass(frozen=True)
class JointSums:
    """What the likelihoods need of one joint's residuals z and columns B beside them.

    Attributes:
        gram: Banded ``S^T S``, (2 K, C).
        along: ``S^T [z B]``, (C, 1 + k).
        squares: ``[z B]^T [z B]``, (1 + k, 1 + k).
        count: How many residuals.
    """

    gram: Array
    along: Array
    squares: Array
    count: int


def joint_sums(found: Responses, values: Array, noise: Array) -> list[JointSums]:
    """Return the sums of each joint.

    Args:
        found: The responses.
        values: In units of the noise, the residuals, and their changes by numbers of
            the model that are one standard deviation off, (N, 1 + k).
        noise: Of each joint, (joints,).
    """
    sums = []
    for joint in range(len(noise)):
        rows = found.channel == joint
        own, mine = found.part(rows), values[rows]
        along = own.along(mine / noise[joint])
        gram = own.gram() / noise[joint] ** 2
        sums.append(JointSums(gram, along, mine.T @ mine, len(mine)))
    return sums


def log_likelihood(sums: Sequence[JointSums], spread: float, excess: Array) -> float:
    """Return the log-likelihood of times common to some joints, less N log(2 pi) / 2.

    Args:
        sums: Of these joints.
        spread: Standard deviation of the times [s].
        excess: Noise of each joint over what is assumed, (joints,).
    """
    weighted, determinant = _common(sums, spread, excess)
    return _marginal(weighted) - 0.5 * determinant - _size(sums, excess)


def apart_likelihood(sums: Sequence[JointSums], spreads: Array, excess: Array) -> float:
    """Return the log-likelihood of times that each joint has of its own.

    Args:
        sums: Of each joint.
        spreads: Standard deviation of its times, (joints,) [s].
        excess: Its noise over what is assumed, (joints,).
    """
    each = [
        _common([one], float(spread), np.array([size]))
        for one, spread, size in zip(sums, spreads, excess, strict=True)
    ]
    weighted = np.sum([one for one, _ in each], axis=0)
    determinant = sum(one for _, one in each)
    return _marginal(weighted) - 0.5 * determinant - _size(sums, excess)


def quiet_likelihood(sums: Sequence[JointSums], excess: Array) -> float:
    """Return the log-likelihood of noise alone, `excess` times what is assumed."""
    weighted = _weighted([one.squares for one in sums], excess)
    return _marginal(weighted) - _size(sums, excess)


def row_time_likelihood(
    values: Array, speed: Array, excess: Array, channel: Integers, spread: float
) -> float:
    """Return the log-likelihood of rows that were read at times of their own.

    Args:
        values: As for `joint_sums`, row after row with all joints, (N, 1 + k).
        speed: Velocity of each joint in units of its noise [1/s], (N,).
        excess: Noise of each joint over what is assumed, (joints,).
        channel: Joint of each residual, (N,).
        spread: Standard deviation of the times [s].
    """
    joints, size = len(excess), excess[channel]
    rows = (values / size[:, None]).reshape(-1, joints, values.shape[1])
    speed = (speed / size).reshape(-1, joints)
    grown = 1.0 + spread**2 * (speed**2).sum(axis=1)
    along = np.einsum("rjk,rj->rk", rows, speed)
    weighted = np.einsum("rjk,rjl->kl", rows, rows)
    weighted -= (along * (spread**2 / grown)[:, None]).T @ along
    determinant = float(np.log(grown).sum())
    return _marginal(weighted) - 0.5 * determinant - float(np.log(size).sum())


def fit_common(sums: Sequence[JointSums], excess: Array) -> tuple[float, Array]:
    """Return the likeliest spread [s] of common times, and each joint's excess.

    Args:
        sums: Of each joint.
        excess: Of the joints' noise up to a factor, which is fitted, (joints,).
    """
    spread, factor = _simplex(
        lambda spread, factor: log_likelihood(sums, spread, factor * excess)
    )
    return spread, factor * excess


def fit_spread(sums: Sequence[JointSums], excess: Array) -> float:
    """Return the likeliest spread [s] of common times for a known excess (joints,)."""
    return _best(lambda spread: log_likelihood(sums, spread, excess), _SPREADS)


def fit_each(sums: Sequence[JointSums]) -> tuple[Array, Array]:
    """Return each joint's own spread [s] and excess of noise, (joints,) both."""
    found = [_fit_alone(one) for one in sums]
    spread, excess = np.array(found).T
    return spread, excess


def _fit_alone(one: JointSums) -> tuple[float, float]:
    return _simplex(
        lambda spread, excess: log_likelihood([one], spread, np.array([excess]))
    )


def fit_quiet(sums: Sequence[JointSums]) -> Array:
    """Return each joint's excess of noise where there is nothing else, (joints,)."""
    return np.array([_fit_noise(one) for one in sums])


def _fit_noise(one: JointSums) -> float:
    return _best(lambda size: quiet_likelihood([one], np.array([size])), _NOISES)


def fit_row_times(
    values: Array, speed: Array, excess: Array, channel: Integers
) -> float:
    """Return the likeliest spread of the times of rows [s]."""
    return _best(
        lambda spread: row_time_likelihood(values, speed, excess, channel, spread),
        _SPREADS,
    )


def estimated(sums: Sequence[JointSums], spread: float, excess: Array) -> Array:
    """Return the likeliest time by which each command is late, (C,) [s].

    Args:
        sums: Of each joint.
        spread: Standard deviation of the times [s].
        excess: Noise of each joint over what is assumed, (joints,).
    """
    _, solved = _solved(sums, spread, excess)
    amounts = beside(sums, spread, excess)
    # Their responses, times these, are what the residual must lose.
    return np.asarray(-(solved[:, 0] - solved[:, 1:] @ amounts))


def beside(sums: Sequence[JointSums], spread: float, excess: Array) -> Array:
    """Return the likeliest amounts of the columns B beside the times, (k,).

    Args:
        sums: Of each joint.
        spread: Standard deviation of the times [s].
        excess: Noise of each joint over what is assumed, (joints,).
    """
    weighted, _ = _common(sums, spread, excess)
    squares = weighted[1:, 1:] + np.eye(len(weighted) - 1)
    return np.asarray(np.linalg.solve(squares, weighted[1:, 0]))


def spread_interval(
    sums: Sequence[JointSums], spread: float, excess: Array, errors: float
) -> float:
    """Return half the width of the interval of a spread [s].

    It is from the curvature of the log-likelihood over the spread's logarithm.

    Args:
        sums: Of each joint.
        spread: The likeliest.
        excess: Noise of each joint over what is assumed, (joints,).
        errors: Half the width in standard errors.
    """
    less, best, more = (
        log_likelihood(sums, spread * float(np.exp(away)), excess)
        for away in (-_CURVED, 0.0, _CURVED)
    )
    curvature = (2.0 * best - less - more) / _CURVED**2
    return errors * spread / float(np.sqrt(max(curvature, 1.0)))


def _common(
    sums: Sequence[JointSums], spread: float, excess: Array
) -> tuple[Array, float]:
    """Return ``[z B]^T V^-1 [z B]`` for ``V = D + s^2 S S^T``, and log |V| / |D|."""
    factor, solved = _solved(sums, spread, excess)
    along = _weighted([one.along for one in sums], excess)
    weighted = _weighted([one.squares for one in sums], excess) - along.T @ solved
    return weighted, 2.0 * float(np.log(factor[0]).sum())


def _solved(
    sums: Sequence[JointSums], spread: float, excess: Array
) -> tuple[Array, Array]:
    """Return the factor of ``I + s^2 S^T S``, and its inverse times s^2 S^T [z B]."""
    banded = spread**2 * _weighted([one.gram for one in sums], excess)
    banded[0] += 1.0
    factor = linalg.cholesky_banded(banded, lower=True)
    along = spread**2 * _weighted([one.along for one in sums], excess)
    return factor, np.asarray(linalg.cho_solve_banded((factor, True), along))


def _marginal(weighted: Array) -> float:
    """Return the log-likelihood of z, with B in its covariance, from their products."""
    beside = weighted[1:, 1:] + np.eye(len(weighted) - 1)
    crossed = weighted[1:, 0]
    _, determinant = np.linalg.slogdet(beside)
    explained = crossed @ np.linalg.solve(beside, crossed)
    return -0.5 * float(weighted[0, 0] - explained + determinant)


def _weighted(rows: Sequence[Array], excess: Array) -> Array:
    return np.asarray(np.tensordot(excess**-2.0, np.stack(rows), 1))


def _size(sums: Sequence[JointSums], excess: Array) -> float:
    counts = [one.count for one in sums]
    return float(np.dot(counts, np.log(excess)))


def _simplex(likelihood: Callable[[float, float], float]) -> tuple[float, float]:
    """Return the likeliest spread and size of noise."""

    def cost(logs: Array) -> float:
        spread, size = np.exp(logs)
        return -likelihood(float(spread), float(size))

    done = optimize.minimize(
        cost,
        np.log([5e-3, 1.0]),
        method="Nelder-Mead",
        bounds=[np.log(_SPREADS), np.log(_NOISES)],
        options={"xatol": 0.02, "fatol": 0.05},
    )
    spread, size = np.exp(done.x)
    return float(spread), float(size)


def _best(likelihood: Callable[[float], float], bounds: tuple[float, float]) -> float:
    done = optimize.minimize_scalar(
        lambda log: -likelihood(float(np.exp(log))),
        bounds=tuple(np.log(bounds)),
        method="bounded",
        options={"xatol": 0.01},
    )
    return float(np.exp(done.x))
