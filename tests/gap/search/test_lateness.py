"""Likelihoods of late commands against dense covariances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from rlco.gap.compare.arm.commands.late import Responses
from rlco.gap.search.lateness import (
    apart_likelihood,
    estimated,
    fit_common,
    fit_each,
    joint_sums,
    log_likelihood,
    quiet_likelihood,
    row_time_likelihood,
)

JOINTS, ROWS, TEETH, COMMANDS = 2, 40, 4, 20
BESIDE = 3  # columns of numbers that are a little off
NOISE = np.array([0.5, 2.0])
EXCESS = np.array([1.2, 0.9])
SPREAD = 0.15


def _responses() -> Responses:
    """Return responses of two joints; each row remembers up to four commands."""
    random = np.random.default_rng(1)
    latest = np.arange(ROWS) // 2
    teeth = np.arange(TEETH)
    command = latest[:, None] - (latest[:, None] - teeth) % TEETH
    command[20:, 1] -= TEETH  # one that is later than those sent after it
    command = np.repeat(np.where(command >= 0, command, -1), JOINTS, axis=0)
    rows = random.normal(0.0, 2.0, command.shape) * (command >= 0)
    channel = np.tile(np.arange(JOINTS), ROWS)
    block = np.zeros(len(channel), dtype=np.int64)
    return Responses(channel, block, rows, command, COMMANDS)


def _dense(found: Responses) -> NDArray[np.float64]:
    matrix = np.zeros((len(found.rows), COMMANDS))
    for row, (values, columns) in enumerate(
        zip(found.rows, found.command, strict=True)
    ):
        for value, column in zip(values, columns, strict=True):
            if column >= 0:
                matrix[row, column] += value
    return matrix


def _constant(found: Responses) -> float:
    """Return what the likelihoods leave out: it is the same for all of them."""
    return 0.5 * len(found.channel) * float(np.log(2.0 * np.pi))


def test_the_banded_likelihood_is_that_of_the_whole_covariance() -> None:
    found = _responses()
    matrix = _dense(found) / NOISE[found.channel][:, None]
    values = np.random.default_rng(2).normal(0.0, 1.5, (len(matrix), 1 + BESIDE))
    z, beside = values[:, 0], values[:, 1:]
    covariance = SPREAD**2 * matrix @ matrix.T + beside @ beside.T
    covariance += np.diag(EXCESS[found.channel] ** 2)
    expected = multivariate_normal(np.zeros(len(z)), covariance).logpdf(z)
    ours = log_likelihood(joint_sums(found, values, NOISE), SPREAD, EXCESS)
    np.testing.assert_allclose(ours - _constant(found), expected, rtol=1e-10)


def test_estimated_times_are_those_of_ridge_regression() -> None:
    found = _responses()
    weights = 1.0 / (NOISE * EXCESS)[found.channel]
    matrix = _dense(found) * weights[:, None]
    late = np.random.default_rng(3).normal(0.0, SPREAD, COMMANDS)
    # A residual is measured minus simulated, and the simulation is in time.
    z = -found.by(late) / NOISE[found.channel]
    beside = np.random.default_rng(6).normal(0.0, 0.3, (len(z), BESIDE))
    z = z + beside @ [1.0, -0.5, 0.5]
    columns = np.concatenate([matrix, beside / EXCESS[found.channel][:, None]], axis=1)
    prior = np.diag(np.r_[np.full(COMMANDS, SPREAD**-2.0), np.ones(BESIDE)])
    goal = columns.T @ (z / EXCESS[found.channel])
    expected = -np.linalg.solve(columns.T @ columns + prior, goal)[:COMMANDS]
    values = np.column_stack([z, beside])
    ours = estimated(joint_sums(found, values, NOISE), SPREAD, EXCESS)
    np.testing.assert_allclose(ours, expected, atol=1e-10)
    assert np.corrcoef(ours, late)[0, 1] > 0.95


def test_row_times_have_a_covariance_along_the_velocities_of_each_row() -> None:
    random = np.random.default_rng(4)
    channel = np.tile(np.arange(JOINTS), ROWS)
    values = random.normal(0.0, 1.5, (len(channel), 1 + BESIDE))
    z, speed = values[:, 0], random.normal(0.0, 1.5, len(channel))
    covariance = np.diag(EXCESS[channel] ** 2) + values[:, 1:] @ values[:, 1:].T
    for row in range(ROWS):
        two = slice(2 * row, 2 * row + 2)
        covariance[two, two] += SPREAD**2 * np.outer(speed[two], speed[two])
    expected = multivariate_normal(np.zeros(len(z)), covariance).logpdf(z)
    ours = row_time_likelihood(values, speed, EXCESS, channel, SPREAD)
    constant = 0.5 * len(z) * np.log(2.0 * np.pi)
    np.testing.assert_allclose(ours - constant, expected, rtol=1e-10)


def test_a_common_cause_is_likelier_than_one_a_joint_if_it_is_common() -> None:
    channel = np.tile(np.arange(JOINTS), 400)
    latest = np.arange(400)
    command = latest[:, None] - (latest[:, None] - np.arange(TEETH)) % TEETH
    command = np.repeat(np.where(command >= 0, command, -1), JOINTS, axis=0)
    random = np.random.default_rng(5)
    rows = random.normal(0.0, 5.0, command.shape) * (command >= 0)
    found = Responses(channel, np.zeros_like(channel), rows, command, 400)
    noise = random.normal(0.0, 1.0, len(channel))
    for common in (True, False):
        times = random.normal(0.0, SPREAD, (JOINTS, 400))
        if common:
            times[1] = times[0]
        moved = [found.by(times[joint]) for joint in range(JOINTS)]
        z = noise - np.where(channel == 0, moved[0], moved[1])
        sums = joint_sums(found, z[:, None], np.ones(JOINTS))
        spreads, excess = fit_each(sums)
        each = apart_likelihood(sums, spreads, excess)
        spread, both = fit_common(sums, excess)
        together = log_likelihood(sums, spread, both)
        assert each > quiet_likelihood(sums, np.full(JOINTS, z.std())) + 20.0
        assert (together > each + 20.0) == common
