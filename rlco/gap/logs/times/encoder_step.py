"""The step of an encoder, from its samples."""

from __future__ import annotations

import numpy as np

from rlco.gap.logs.log import Array


def encoder_step(values: Array) -> float:
    """Return the step of which all differences are multiples; 0 where there is none.

    Args:
        values: Samples of one channel, (T,).

    Example:
        >>> turn = np.sin(np.arange(400.0))
        >>> round(encoder_step(np.round(turn / 0.01) * 0.01), 6), encoder_step(turn)
        (0.01, 0.0)
    """
    levels = np.unique(values)
    finest = float(np.spacing(np.abs(values).max().astype(np.float32)))
    gaps = np.diff(levels)
    gaps = gaps[gaps > 4.0 * finest]
    few = len(gaps) < 8 and len(levels) > len(values) / 10
    step = float(gaps.min(initial=np.inf))
    if few or step < 50.0 * finest or not len(gaps):
        return 0.0
    multiples = np.round(gaps / step)
    off = np.abs(gaps / step - multiples)
    if np.mean(off < 0.02 + 2.0 * finest / step) < 0.98:
        return 0.0
    return float(gaps.sum() / multiples.sum())
