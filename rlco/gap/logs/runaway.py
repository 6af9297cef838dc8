"""Recordings far from all others: a robot or a sensor that ran away in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# A recording whose signals are larger than the usual ones' by this factor ran away.
_TIMES = 20.0
_FEWEST = 3  # recordings, to say what is usual


def runaway(sizes: ArrayLike) -> NDArray[np.bool_]:
    """Return which recordings are far larger than usual, (recordings,).

    Args:
        sizes: How large the signals of each recording are, (recordings,).

    Example:
        >>> runaway([1.0, 2.0, 1e6, 0.5]), runaway([1.0, 1e6])
        (array([False, False,  True, False]), array([False, False]))
    """
    given = np.asarray(sizes, dtype=float)
    if len(given) < _FEWEST:
        return np.zeros(len(given), dtype=np.bool_)
    return np.asarray(given > _TIMES * np.median(given))
