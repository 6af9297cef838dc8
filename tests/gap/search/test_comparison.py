"""When one explanation is better than another beyond doubt."""

from __future__ import annotations

import numpy as np
import pytest

from rlco.gap.search.comparison import (
    better_by_both,
    block_test,
    clearly_better,
    correlation_length,
    likelihood_test,
)

_BLOCKS = np.repeat(np.arange(40), 50)


def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=len(_BLOCKS))


def test_the_block_test_by_hand() -> None:
    one, other = np.array([1.0, 0.0, 2.0, 0.0]), np.array([2.0, 0.0, 3.0, 0.0])
    # Sums of squares fall by 3 and by 5: mean 4, standard error sqrt(2) / sqrt(2) = 1.
    assert block_test(one, other, np.array([0, 0, 1, 1])) == pytest.approx(4.0)


def test_a_constant_residual_counts_once_a_block_and_noise_counts_fully() -> None:
    constant = np.ones(len(_BLOCKS))
    assert correlation_length(constant, _BLOCKS) == pytest.approx(50.0)
    assert correlation_length(_noise(0), _BLOCKS) == pytest.approx(1.0, abs=0.5)


def test_two_noises_of_one_size_are_not_told_apart() -> None:
    wrong = sum(
        clearly_better(_noise(i), _noise(i + 1000), _BLOCKS, _BLOCKS)
        for i in range(100)
    )
    assert wrong <= 3


def test_an_effect_in_one_second_of_forty_is_found_by_the_likelihood() -> None:
    best = _noise(1)
    other = best + np.where(_BLOCKS == 7, 6.0, 0.0)
    assert block_test(best, other, _BLOCKS) < 3.0
    # Fifty rows, 6 apart: a ratio of some 50 x 36, which varies by 2 x 6 x sqrt(50).
    assert likelihood_test(best, other, _BLOCKS) == pytest.approx(21.2, rel=0.15)
    assert clearly_better(best, other, _BLOCKS, _BLOCKS)
    assert not clearly_better(other, best, _BLOCKS, _BLOCKS)
    # One second is not all that both tests ask for; each second is.
    assert not better_by_both(best, other, _BLOCKS, _BLOCKS)
    assert better_by_both(best, best + 0.5, _BLOCKS, _BLOCKS)


def test_two_wrong_models_need_more_than_a_small_difference() -> None:
    # Both leave ten times the noise, in waves; one leaves a hundredth less.
    wave = 10.0 * np.repeat(np.random.default_rng(2).normal(size=40), 50)
    other = wave * np.random.default_rng(3).uniform(0.7, 1.33, 40).repeat(50)
    assert not clearly_better(wave, other, _BLOCKS, _BLOCKS)
