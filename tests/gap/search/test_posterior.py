"""Parameter sets from the intervals of a fit."""

from __future__ import annotations

import numpy as np
import pytest

from rlco.gap.search.intervals import NORMAL, half_widths
from rlco.gap.search.posterior import sample
from rlco.physics.effects import Parameter


def parameter(low: float, high: float, resolution: float = 0.0) -> Parameter:
    return Parameter("p", "", low, high, 0.0, (1.0,), resolution=resolution)


def line(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the fit of a line to 400 points: truth (2, -1), unit noise.

    Residual = measured - simulated, so that its Jacobian is minus the design.
    """
    rng = np.random.default_rng(seed)
    # Far from the origin, so that height and slope go together.
    design = np.stack([np.ones(400), np.linspace(2.0, 4.0, 400)])
    measured = np.array([2.0, -1.0]) @ design + rng.standard_normal(400)
    found = np.linalg.solve(design @ design.T, design @ measured)
    return found, -design, measured - found @ design


def test_the_sample_has_the_covariance_of_a_linear_fit() -> None:
    found, jacobian, residual = line(0)
    blocks = np.arange(400) // 4
    widths, correlation = half_widths(jacobian, residual, blocks, jacobian)
    known = [parameter(-99.0, 99.0)] * 2
    sets = sample(known, found, widths, correlation)
    # The resampled blocks and the prior each add the covariance of least squares,
    # which by hand has 1 / 400 (1 + 9 / (1 / 3)) for the height, 1 / 400 / (1 / 3) for
    # the slope, and a correlation of -3 / sqrt(9 + 1 / 3).
    by_hand = np.array([[1.0 + 9.0 * 3.0, -9.0], [-9.0, 3.0]]) / 400.0
    covariance = np.cov(sets, rowvar=False)
    np.testing.assert_allclose(sets.mean(axis=0), found, atol=0.02 * widths.max())
    np.testing.assert_allclose(covariance, 2.0 * by_hand, rtol=0.25)
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert correlation == pytest.approx(-3.0 / np.sqrt(9.0 + 1.0 / 3.0), abs=0.01)
    # The pair is known far better together than each alone.
    middle = sets @ np.array([1.0, 3.0])
    assert middle.std() < 0.25 * sets[:, 0].std()
    assert middle.std() == pytest.approx(np.sqrt(2.0 / 400.0), rel=0.25)


def test_ninety_per_cent_of_the_sets_are_within_the_interval() -> None:
    pair = np.array([[1.0, -0.8], [-0.8, 1.0]])
    widths = np.array([0.3, 0.02])
    sets = sample([parameter(0.0, 9.0)] * 2, np.array([2.0, 1.0]), widths, pair)
    within = (np.abs(sets - [2.0, 1.0]) <= widths).mean(axis=0)
    np.testing.assert_allclose(within, 0.9, atol=1.5 / 64)


def test_the_sets_cover_the_truth_of_repeated_recordings() -> None:
    covered, truth = [], np.array([2.0, -1.0])
    for seed in range(150):
        found, jacobian, residual = line(seed)
        # Only what the noise leaves open, without a tolerance of the model.
        widths, correlation = half_widths(
            jacobian, residual, np.arange(400) // 4, 1e6 * jacobian
        )
        sets = sample([parameter(-99.0, 99.0)] * 2, found, widths, correlation)
        low, high = np.quantile(sets, [0.05, 0.95], axis=0)
        covered.append((low <= truth) & (high >= truth))
    # 90 % with a standard error of 2.5 %.
    np.testing.assert_allclose(np.mean(covered, axis=0), 0.9, atol=0.08)


def test_no_set_goes_where_a_parameter_may_not() -> None:
    known = [parameter(0.0, 9.0), parameter(-1.0, 1.0)]
    pair = np.array([[1.0, 0.9], [0.9, 1.0]])
    sets = sample(known, np.array([0.1, 0.95]), np.array([0.5, 0.3]), pair)
    assert (sets >= [0.0, -1.0]).all()
    assert (sets <= [9.0, 1.0]).all()
    assert len(np.unique(sets[:, 0])) == len(sets)  # none is put onto a bound


def test_a_fit_at_its_bounds_still_has_all_its_sets() -> None:
    known = [parameter(0.0, 1e-9)] * 3
    sets = sample(known, np.zeros(3), np.ones(3), np.eye(3))
    assert sets.shape == (64, 3)
    assert (sets <= 1e-9).all()


def test_what_changes_in_steps_is_spread_evenly_over_its_interval() -> None:
    known = [parameter(0.0, 9.0, resolution=0.02)]
    sets = np.sort(sample(known, np.array([0.1]), np.array([0.02]), np.eye(1))[:, 0])
    even = 0.08 + 0.04 * (np.arange(64) + 0.5) / 64
    np.testing.assert_allclose(sets, even, atol=0.04 / 64)


def test_independent_parameters_stay_so() -> None:
    sets = sample([parameter(-9.0, 9.0)] * 3, np.zeros(3), np.ones(3), np.eye(3))
    assert np.abs(np.corrcoef(sets.T) - np.eye(3)).max() < 0.1
    np.testing.assert_allclose(NORMAL * sets.std(axis=0), 1.0, rtol=0.05)
