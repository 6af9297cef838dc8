"""Limit the weight of seconds of a log that no hypothesis explains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array

Rows = NDArray[np.bool_] | Integers

USUAL = 4.0  # ratio to the typical mean square from which blocks count less


@dataclass(frozen=True)
class Outliers:
    """The maximum cost of a block of time.

    When a finger comes down on an object's edge, a millimetre decides to which side it
    falls. A simulation from a measured state then takes another course under any
    hypothesis. The residuals of such seconds may be of any size and would dominate all
    others. With x the mean square of a block, in units of the noise, it counts as
    ``x / (1 + x / limit)``, after Geman and McClure (1985): as x where it is small, and
    never as more than `limit`.

    Attributes:
        blocks: The block of time of each value, (N,).
        limit: Maximum cost of one value in a block.
    """

    blocks: Integers
    limit: float

    @classmethod
    def of(cls, residual: Array, blocks: Integers) -> Outliers:
        """Return the limit for a log in which much may still be missing.

        Args:
            residual: Without any effect, in units of the noise, (N,).
            blocks: The block of time of each value, (N,).
        """
        _, place = np.unique(blocks, return_inverse=True)
        sizes = np.bincount(place, weights=residual**2) / np.bincount(place)
        return cls(blocks, USUAL * max(1.0, float(np.median(sizes))))

    def part(self, rows: Rows) -> Outliers:
        """Return the limits of some of the values, given by mask or index."""
        return Outliers(self.blocks[rows], self.limit)

    def bound(self, residuals: Array) -> Array:
        """Return residuals (..., N) scaled down to their maximum cost.

        Example:
            >>> seconds = Outliers(np.array([0, 0, 1, 1]), limit=4.0)
            >>> seconds.bound(np.array([0.1, -0.1, 40.0, 40.0])).round(2).tolist()
            [0.1, -0.1, 2.0, 2.0]
        """
        return self._scaled(residuals, lambda cost: 1.0 + cost / self.limit)

    def cut(self, residuals: Array) -> Array:
        """Return residuals (..., N) whose blocks cost at most the limit.

        For a size that is to be known, not to be made small: what costs less stays as
        it is.

        Example:
            >>> seconds = Outliers(np.array([0, 0, 1, 1]), limit=4.0)
            >>> seconds.cut(np.array([1.0, -1.0, 40.0, 40.0])).tolist()
            [1.0, -1.0, 2.0, 2.0]
        """
        return self._scaled(residuals, lambda cost: np.maximum(cost / self.limit, 1.0))

    def _scaled(self, residuals: Array, divisor: Callable[[Array], Array]) -> Array:
        """Return residuals with each block's mean square divided."""
        _, place = np.unique(self.blocks, return_inverse=True)
        counts = np.bincount(place)
        flat = residuals.reshape(-1, residuals.shape[-1])
        out = np.empty_like(flat)
        for row, residual in enumerate(flat):
            cost = np.bincount(place, weights=residual**2) / counts
            out[row] = residual / np.sqrt(divisor(cost))[place]
        return out.reshape(residuals.shape)
