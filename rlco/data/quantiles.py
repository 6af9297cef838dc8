"""Exact quantiles over all frames, for the normalisation of states and actions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from rlco.errors import ConfigError, DataError


def exact_quantiles(
    *values: npt.ArrayLike, q: Sequence[float] = (0.01, 0.99)
) -> npt.NDArray[np.float64]:
    """Return each dimension's quantiles over the frames of all the data together.

    Computed in float64 with linear interpolation between order statistics (NumPy's
    default definition).

    Args:
        *values: One or several data sets, each of shape (frames, dimensions) in the
            same raw units. Every frame counts once, so a longer data set weighs more.
        q: Quantiles, each in [0, 1].

    Returns:
        Shape (len(q), dimensions), in the units of ``values``.

    Raises:
        DataError: No frames, other dimensions from set to set, or a value that is
            NaN or infinite.
        ConfigError: A quantile outside [0, 1].

    Example:
        >>> sim, real = [[0.0], [1.0], [2.0]], [[10.0], [11.0]]
        >>> exact_quantiles(sim, real, q=(0.25, 0.5)).tolist()
        [[1.0], [2.0]]
    """
    # LeRobot 0.6.1 stores, as a data set's q01 and q99, the frame-weighted MEAN of
    # its episodes' quantiles. Where episodes differ (several tasks, sim mixed with
    # real) that mean lies well inside the data: the tails of every episode away from
    # the centre are taken for outliers, and much more than 2 % of the frames falls
    # outside [q01, q99]. Quantiles do not average, so they are taken over all frames.
    if not q or not all(0.0 <= quantile <= 1.0 for quantile in q):
        raise ConfigError([f"q={tuple(q)} must be quantiles in [0, 1]"])
    sets = [np.asarray(value, np.float64) for value in values]
    shapes = [array.shape for array in sets]
    if (
        any(len(shape) != 2 for shape in shapes)
        or len({shape[1] for shape in shapes}) != 1
        or not sum(shape[0] for shape in shapes)
    ):
        raise DataError(
            f"quantiles need data sets of shape (frames, dimensions), alike in their "
            f"dimensions and not all empty, but the shapes are {shapes}."
        )
    frames = np.concatenate(sets)
    if not np.isfinite(frames).all():
        raise DataError("quantiles of data with NaN or infinite values do not exist.")
    return np.asarray(np.quantile(frames, q, axis=0), np.float64)
