"""The delays that commands were drawn with, from when they took effect."""

from __future__ import annotations

import numpy as np
import pytest

from rlco.gap.search.steps.random_delay import before_waiting


@pytest.mark.parametrize(("mean", "spread"), [(0.028, 0.023), (0.01, 0.009)])
def test_delays_are_those_before_commands_wait_for_each_other(
    mean: float, spread: float
) -> None:
    sent = 0.02 * np.arange(4000)
    shape, scale = (mean / spread) ** 2, spread**2 / mean
    arrives = sent + np.random.default_rng(5).gamma(shape, scale, len(sent))
    late = np.maximum.accumulate(arrives) - sent
    assert late.mean() > 1.04 * mean  # they wait
    found = before_waiting([sent[:2500], sent[2500:]], late.mean(), late.std())
    assert found == pytest.approx((mean, spread), rel=0.04)
