"""Seconds of a log that no hypothesis explains, kept from deciding between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rlco.gap.log import Array
from rlco.gap.problem import Integers

Rows = NDArray[np.bool_] | Integers

USUAL = 4.0  # mean squares beyond this many typical ones begin to count less


@dataclass(frozen=True)
class Outliers:
    """What a block of time may cost at most.

    A finger comes down on an object's edge, and a millimetre decides on which side it
    falls: a simulation from a measured state then goes another way, whatever is
    hypothesised. Such seconds have residuals of any size, and would outvote all others.
    With x the mean square of a block, in units of the noise, it counts as
    ``x / (1 + x / limit)``, after Geman and McClure (1985): x where it is small,
    never more than `limit`.

    Attributes:
        blocks: The block of time of each number, (N,).
        limit: What one number of a block costs at most.
    """

    blocks: Integers
    limit: float

    @classmethod
    def of(cls, residual: Array, blocks: Integers) -> Outliers:
        """Return the limit for a log in which much may be missing yet.

        Args:
            residual: Without any effect, in units of the noise, (N,).
            blocks: The block of time of each number, (N,).
        """
        _, place = np.unique(blocks, return_inverse=True)
        sizes = np.bincount(place, weights=residual**2) / np.bincount(place)
        return cls(blocks, USUAL * max(1.0, float(np.median(sizes))))

    def part(self, rows: Rows) -> Outliers:
        """Return the same for some of the numbers, given by mask or index."""
        return Outliers(self.blocks[rows], self.limit)

    def bound(self, residuals: Array) -> Array:
        """Return residuals (..., N) that cost no more than they may.

        Example:
            >>> seconds = Outliers(np.array([0, 0, 1, 1]), limit=4.0)
            >>> seconds.bound(np.array([0.1, -0.1, 40.0, 40.0])).round(2).tolist()
            [0.1, -0.1, 2.0, 2.0]
        """
        _, place = np.unique(self.blocks, return_inverse=True)
        counts = np.bincount(place)
        flat = residuals.reshape(-1, residuals.shape[-1])
        out = np.empty_like(flat)
        for row, residual in enumerate(flat):
            sizes = np.bincount(place, weights=residual**2) / counts
            out[row] = residual / np.sqrt(1.0 + sizes / self.limit)[place]
        return out.reshape(residuals.shape)
