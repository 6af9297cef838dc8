"""Parameter sets that are about as believable as a fit: a sample of its posterior.

The intervals and their correlations describe a normal distribution, whose 90 % are the
intervals. It is cut off where a parameter may not go. A parameter that changes in
steps has an interval but no gradient: it is spread evenly over it, by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from rlco.gap.logs.log import Array
from rlco.gap.search.intervals import NORMAL
from rlco.physics.effects import Parameter

SETS = 64
_TRIED = 2**12  # points, of which those within the bounds are taken


def sample(
    known: Sequence[Parameter],
    values: Array,
    widths: Array,
    correlation: Array,
    count: int = SETS,
) -> Array:
    """Return parameter sets, (count, parameters).

    The points are those of a scrambled Sobol sequence (Owen, Journal of Complexity
    1998), always the same: a few dozen of them have the distribution's moments, which
    independent draws would have only within a tenth.

    Args:
        known: The parameters, for their bounds.
        values: As fitted, (parameters,).
        widths: Half the width of each 90 % interval, (parameters,).
        correlation: Of the parameters, (parameters, parameters).
        count: How many.

    Example:
        >>> friction = Parameter("frictionloss", "N m", 0.0, 9.0, 0.0, (1.0,))
        >>> pair = np.array([[1.0, 0.9], [0.9, 1.0]])
        >>> found = sample([friction] * 2, np.array([2.0, 3.0]), np.full(2, 0.2), pair)
        >>> found.mean(axis=0).round(2).tolist()
        [2.0, 3.0]
        >>> (NORMAL * found.std(axis=0)).round(1).tolist()
        [0.2, 0.2]
        >>> bool(abs(np.corrcoef(found.T)[0, 1] - 0.9) < 0.03)
        True
    """
    low = np.array([parameter.low for parameter in known])
    high = np.array([parameter.high for parameter in known])
    stepped = np.array([parameter.resolution > 0.0 for parameter in known])
    even = qmc.Sobol(len(known), seed=0).random(_TRIED)
    even = np.clip(even, 1e-12, 1.0 - 1e-12)
    far, turned = np.linalg.eigh(correlation)
    root = turned * np.sqrt(np.maximum(far, 0.0))
    moved = (ndtri(even) @ root.T) / NORMAL
    moved[:, stepped] = 2.0 * even[:, stepped] - 1.0
    found = values + widths * moved
    within = ((found >= low) & (found <= high)).all(axis=1)
    # A fit at its bounds may leave too few within them: the rest are put onto these.
    order = np.argsort(~within, kind="stable")[:count]
    return np.asarray(np.clip(found[order], low, high))
