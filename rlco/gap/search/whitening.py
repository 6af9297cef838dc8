"""Whitening of residuals under the model tolerance.

A residual r is measured minus simulated. If nothing is missing, its covariance is that
of the measurement and of the model tolerance: in units of the noise's standard
deviation, ``I + s^2 J J^T``, where J is the change per tolerance parameter and s its
prior. Residuals are multiplied by the inverse square root of this covariance. What a
small tolerance explains then costs little; the rest keeps its weight.

Thousands of rows outweigh any prior, and would let tolerance parameters grow to absurd
values instead of naming an effect. The prior therefore counts several times: so often
that one tolerance parameter `FAR` standard deviations off costs as much as a residual
that is `COST` larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.gap.logs.log import Array
from rlco.gap.search.outliers import Outliers

FAR = 3.5
COST = 0.03


def often(rows: int) -> float:
    """Return how often the prior counts beside so many rows.

    Example:
        >>> round(often(10_000), 1), often(-1)
        (49.7, 1.0)
    """
    return max(1.0, ((1.0 + COST) ** 2 - 1.0) * rows / FAR**2)


@dataclass(frozen=True)
class Whitening:
    """The whitening of residuals of N values.

    Attributes:
        scale: Standard deviation of the measurement of each value, (N,).
        basis: Orthonormal directions of the tolerance's change, (N, k).
        shrink: Factor of the residual along each of them, in (0, 1], (k,).
        tolerance: Maps what of a scaled residual is along each of them to the tolerance
            parameters that explain it best, (spread, k).
        outliers: Maximum cost of a block of time; None where it is unlimited.
    """

    scale: Array
    basis: Array
    shrink: Array
    tolerance: Array
    outliers: Outliers | None = None

    @classmethod
    def of(
        cls,
        scale: Array,
        jacobian: Array,
        prior: Array,
        rows: int = 0,
        outliers: Outliers | None = None,
    ) -> Whitening:
        """Return the whitening for a Jacobian of the residual.

        Args:
            scale: Standard deviation of each value, (N,).
            jacobian: Change of the residual per tolerance parameter, (spread, N).
            prior: Standard deviation of each tolerance parameter, (spread,).
            rows: Number of values of the whole log, where this is a part of it; below
                zero the prior counts once.
            outliers: Maximum cost of blocks of time.
        """
        prior = prior / np.sqrt(often(rows or len(scale)))
        moved = (jacobian * prior[:, None] / scale).T
        if moved.shape[1] == 0:
            none = np.zeros((len(scale), 0))
            return cls(scale, none, np.zeros(0), np.zeros((0, 0)), outliers)
        # Eigenvectors of the small side are cheaper than a decomposition of all rows.
        squares, vectors = np.linalg.eigh(moved.T @ moved)
        kept = squares > 1e-9 * max(float(squares.max()), 1e-300)
        squares, vectors = squares[kept], vectors[:, kept]
        basis = moved @ (vectors / np.sqrt(squares))
        shrink = 1.0 / np.sqrt(1.0 + squares)
        ridge = vectors * (np.sqrt(squares) / (1.0 + squares))
        return cls(scale, basis, shrink, -prior[:, None] * ridge, outliers)

    def whiten(self, residuals: Array) -> Array:
        """Return whitened residuals, of unit variance where nothing is missing.

        Args:
            residuals: (..., N).
        """
        scaled = self.scaled(residuals)
        along = scaled @ self.basis
        return np.asarray(scaled + (along * (self.shrink - 1.0)) @ self.basis.T)

    def scaled_from(self, whitened: Array) -> Array:
        """Invert the whitening: residuals (..., N) in units of the noise."""
        along = whitened @ self.basis
        return np.asarray(whitened + (along * (1.0 / self.shrink - 1.0)) @ self.basis.T)

    def scaled(self, residuals: Array) -> Array:
        """Return residuals (..., N) in units of the noise, outliers bounded."""
        scaled = residuals / self.scale
        return scaled if self.outliers is None else self.outliers.bound(scaled)

    def beyond_tolerance(self, scaled: Array) -> Array:
        """Return a scaled residual less what the tolerance best explains, (N,)."""
        # The factor that ridge regression leaves of a direction is its weight squared.
        along = scaled @ self.basis
        return np.asarray(scaled + (along * (self.shrink**2 - 1.0)) @ self.basis.T)

    def explain(self, residual: Array) -> Array:
        """Return tolerance parameters that best explain a residual (N,), (spread,)."""
        return np.asarray(self.tolerance @ (self.scaled(residual) @ self.basis))
