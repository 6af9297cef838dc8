"""Residuals weighted by noise and the common small spread."""

from __future__ import annotations

import numpy as np

from rlco.gap.search.whitening import COST, FAR, Whitening

_random = np.random.default_rng(0)
_JACOBIAN = _random.normal(size=(3, 40))
_SCALE = _random.uniform(0.5, 2.0, 40)
_PRIOR = np.array([0.3, 0.05, 1.0])


def test_weighing_is_the_inverse_square_root_of_the_covariance() -> None:
    whitening = Whitening.of(_SCALE, _JACOBIAN, _PRIOR, -1)
    residual = _random.normal(size=40)
    moved = (_JACOBIAN * _PRIOR[:, None]).T
    covariance = np.diag(_SCALE**2) + moved @ moved.T
    expected = residual @ np.linalg.solve(covariance, residual)
    np.testing.assert_allclose(np.sum(whitening.whiten(residual) ** 2), expected)


def test_the_best_spread_is_that_of_ridge_regression() -> None:
    whitening = Whitening.of(_SCALE, _JACOBIAN, _PRIOR, -1)
    residual = _random.normal(size=40)
    rows = np.vstack([(_JACOBIAN / _SCALE).T, np.diag(1 / _PRIOR)])
    goal = np.concatenate([-residual / _SCALE, np.zeros(3)])
    expected = np.linalg.lstsq(rows, goal, rcond=None)[0]
    np.testing.assert_allclose(whitening.explain(residual), expected)


def test_a_far_spread_costs_as_much_as_the_stated_part_of_the_residual() -> None:
    # One number that moves 10,000 rows so strongly that the data decides.
    rows = 10_000
    jacobian, prior = np.full((1, rows), 1e3), np.array([0.03])
    whitening = Whitening.of(np.ones(rows), jacobian, prior)
    off = FAR * prior[0] * jacobian[0]
    # Mean square of the weighted residual, above which noise would add 1.
    np.testing.assert_allclose(
        np.mean(whitening.whiten(off) ** 2), (1 + COST) ** 2 - 1, rtol=1e-3
    )


def test_without_a_spread_only_the_noise_counts() -> None:
    whitening = Whitening.of(np.array([2.0, 4.0]), np.zeros((0, 2)), np.zeros(0))
    np.testing.assert_array_equal(whitening.whiten(np.array([2.0, 2.0])), [1.0, 0.5])


def test_what_was_weighed_comes_back() -> None:
    whitening = Whitening.of(_SCALE, _JACOBIAN, _PRIOR)
    residual = _random.normal(size=(2, 40))
    back = whitening.scaled_from(whitening.whiten(residual))
    np.testing.assert_allclose(back, residual / _SCALE)


def test_beyond_the_best_spread_is_what_its_numbers_leave() -> None:
    whitening = Whitening.of(_SCALE, _JACOBIAN, _PRIOR, -1)
    residual = _random.normal(size=40)
    best = whitening.explain(residual)
    expected = (residual + best @ _JACOBIAN) / _SCALE
    np.testing.assert_allclose(whitening.beyond_tolerance(residual / _SCALE), expected)
