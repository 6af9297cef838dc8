"""What a residual is worth, when the model may be a little off everywhere.

A residual r is measured minus simulated. Its covariance, if nothing is missing, is that
of the measurement and of the common small spread: with the noise's standard deviation
as unit, ``I + s^2 J J^T``, where J holds what one unit of each spread number does and s
is its prior. Residuals are multiplied by the inverse square root of that: what a small
spread explains then costs little, what it cannot keeps its weight.

Thousands of rows outweigh any prior, and let the spread grow to absurd sizes in the
place of an effect. So the prior counts as often as makes one number of the spread that
is `FAR` standard deviations off cost as much as a residual that is `COST` larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.gap.log import Array
from rlco.gap.outliers import Outliers

FAR = 3.5
COST = 0.03


@dataclass(frozen=True)
class Weighting:
    """The weight of residuals of N numbers.

    Attributes:
        scale: Standard deviation of the measurement of each number, (N,).
        basis: Orthonormal directions that the spread moves, (N, k).
        shrink: What is left of each of them, in (0, 1], (k,).
        spread: Their weighted form: turns a scaled residual into the spread that
            explains it best, (numbers of spread, N).
        outliers: What a block of time may cost at most; None where it may cost all.
    """

    scale: Array
    basis: Array
    shrink: Array
    spread: Array
    outliers: Outliers | None = None

    @classmethod
    def of(
        cls,
        scale: Array,
        jacobian: Array,
        prior: Array,
        rows: int = 0,
        outliers: Outliers | None = None,
    ) -> Weighting:
        """Return the weighting for a jacobian of the residual.

        Args:
            scale: Standard deviation of each number, (N,).
            jacobian: Change of the residual a unit of each spread number, (spread, N).
            prior: Standard deviation of each spread number, (spread,).
            rows: Numbers of the whole log, where this is a part of it; below zero the
                prior counts once.
            outliers: What blocks of time may cost at most.
        """
        rows = rows or len(scale)
        often = max(1.0, ((1.0 + COST) ** 2 - 1.0) * rows / FAR**2)
        prior = prior / np.sqrt(often)
        moved = (jacobian * prior[:, None] / scale).T
        if moved.shape[1] == 0:
            none = np.zeros((len(scale), 0))
            return cls(scale, none, np.zeros(0), none.T, outliers)
        # The small side's eigenvectors are cheaper than a decomposition of all rows.
        squares, vectors = np.linalg.eigh(moved.T @ moved)
        kept = squares > 1e-9 * max(float(squares.max()), 1e-300)
        squares, vectors = squares[kept], vectors[:, kept]
        basis = moved @ (vectors / np.sqrt(squares))
        shrink = 1.0 / np.sqrt(1.0 + squares)
        ridge = vectors @ ((1.0 / (1.0 + squares))[:, None] * (vectors.T @ moved.T))
        return cls(scale, basis, shrink, -prior[:, None] * ridge, outliers)

    def weigh(self, residuals: Array) -> Array:
        """Return weighted residuals, of unit variance where nothing is missing.

        Args:
            residuals: (..., N).
        """
        scaled = self.scaled(residuals)
        along = scaled @ self.basis
        return np.asarray(scaled + (along * (self.shrink - 1.0)) @ self.basis.T)

    def scaled_from(self, weighted: Array) -> Array:
        """Return what was weighed, (..., N), in units of the noise."""
        along = weighted @ self.basis
        return np.asarray(weighted + (along * (1.0 / self.shrink - 1.0)) @ self.basis.T)

    def scaled(self, residuals: Array) -> Array:
        """Return residuals (..., N) in units of the noise, outliers bounded."""
        scaled = residuals / self.scale
        return scaled if self.outliers is None else self.outliers.bound(scaled)

    def beyond_spread(self, scaled: Array) -> Array:
        """Return what the best spread leaves of a scaled residual, (N,)."""
        # What ridge regression leaves of a direction is the square of its weight.
        along = scaled @ self.basis
        return np.asarray(scaled + (along * (self.shrink**2 - 1.0)) @ self.basis.T)

    def explain(self, residual: Array) -> Array:
        """Return the spread that best explains a residual (N,), (spread,)."""
        return np.asarray(self.spread @ self.scaled(residual))
