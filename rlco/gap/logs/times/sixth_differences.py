"""Sixth differences of samples over their times: noise without the motion."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from rlco.gap.logs.log import Array

#: Motion that is smooth over seven rows nearly vanishes in sixth differences, even at
#: 30 Hz, while white noise passes unattenuated.
ORDER = 6


def sixth_differences(time: Array, values: Array) -> tuple[Array, Array]:
    """Return scaled sixth divided differences and each window's travel, (windows, C).

    They are scaled so that white noise of deviation s gives s.

    Args:
        time: Rising, (T,) [s].
        values: Samples, (T, C).

    Example:
        >>> time = np.array([0.0, 0.1, 0.3, 0.4, 0.5, 0.7, 0.8, 0.9])
        >>> high, travel = sixth_differences(time, (time**5)[:, None])
        >>> high.shape, bool(np.abs(high).max() < 1e-12), float(travel[1, 0].round(2))
        ((2, 1), True, 0.59)
    """
    if len(time) <= ORDER:
        nothing = np.empty((0, values.shape[1]))
        return nothing, nothing
    times = sliding_window_view(time, ORDER + 1)
    apart = times[:, :, None] - times[:, None, :]
    diagonal = np.arange(ORDER + 1)
    apart[:, diagonal, diagonal] = 1.0
    # Divided difference: f[t0..tn] = sum_i f(ti) / prod_j (ti - tj). By logarithms, as
    # the product of six times that nearly coincide may be no number's size.
    sizes = np.log(np.abs(apart)).sum(axis=2)
    smallest = sizes.min(axis=1, keepdims=True)
    weights = np.sign(apart).prod(axis=2) * np.exp(smallest - sizes)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    windows = sliding_window_view(values, ORDER + 1, axis=0)
    high = np.einsum("ncw,nw->nc", windows, weights)
    return high, np.abs(windows[:, :, -1] - windows[:, :, 0])
