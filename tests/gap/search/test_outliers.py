"""Seconds that nothing explains."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rlco.gap.search.outliers import USUAL, Outliers
from rlco.gap.search.whitening import Whitening

_BLOCKS = np.repeat(np.arange(30), 20)


def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=_BLOCKS.size)


@given(st.floats(1e-3, 1e6), st.floats(1.0, 100.0))
def test_a_block_costs_what_geman_and_mcclure_say(size: float, limit: float) -> None:
    residual = np.full(4, np.sqrt(size))
    bound = Outliers(np.zeros(4, dtype=np.int64), limit).bound(residual)
    np.testing.assert_allclose(np.mean(bound**2), size / (1 + size / limit))


def test_one_broken_second_does_not_outvote_those_that_an_effect_explains() -> None:
    before, after = _noise(0), _noise(0)
    before += 1.5  # what the effect takes away everywhere
    before[_BLOCKS == 7] += 10.0
    after[_BLOCKS == 7] += 40.0  # where a contact went the other way
    assert np.mean(after**2) > np.mean(before**2)
    outliers = Outliers.of(before, _BLOCKS)
    one, other = outliers.bound(after), outliers.bound(before)
    assert np.mean(one**2) < 0.6 * np.mean(other**2)


def test_a_large_gap_everywhere_is_no_outlier() -> None:
    far, near = 30.0 + _noise(1), 15.0 + _noise(1)
    outliers = Outliers.of(far, _BLOCKS)
    np.testing.assert_allclose(outliers.limit, USUAL * 900, rtol=0.05)
    shrunk = np.mean(outliers.bound(near) ** 2) / np.mean(outliers.bound(far) ** 2)
    assert shrunk < 0.35  # a quarter without a bound


def test_weighing_bounds_outliers_and_only_those_it_was_told_of() -> None:
    residual = _noise(2)
    residual[:20] += 100.0
    empty = np.zeros((0, residual.size))
    plain = Whitening.of(np.ones(residual.size), empty, np.zeros(0))
    outliers = Outliers(_BLOCKS, 4.0)
    bounded = Whitening.of(np.ones(residual.size), empty, np.zeros(0), 0, outliers)
    np.testing.assert_array_equal(plain.whiten(residual), residual)
    assert np.mean(bounded.whiten(residual)[:20] ** 2) < 4.0
