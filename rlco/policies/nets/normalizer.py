"""Normalisation by quantiles, owned by the policy and saved with it."""

from __future__ import annotations

import torch
from numpy.typing import ArrayLike
from torch import nn

from rlco.errors import ConfigError, DataError, counted
from rlco.physics.spec.actions import TOLERANCE

#: Half the smallest range of a feature, as a share of its size: eight steps of float32.
_RELATIVE = 2.0**-20


class QuantileNormalizer(nn.Module):
    """Maps raw numbers to about [-1, 1], ``n = 2 (x - low) / (high - low) - 1``.

    ``low`` and ``high`` [size] are buffers, -1 and 1 (the identity) until
    :meth:`set_quantiles` fills them in place, so that losses that hold the buffers
    already see the change. A feature that hardly moved in the data would be blown up
    without bound: its range is widened about its middle to ``min_range``, in the
    feature's own unit, and a constant feature is mapped to 0.

    Args:
        size: how many features.
        name: what they are, for messages.
        min_range: smallest ``high - low``, in the features' units.
        clip: normalised values are clipped to [-clip, clip]; None clips nothing.
        limit: raw numbers are at most so large; None: they may be any.

    Raises:
        DataError: quantiles or inputs of another size, not finite, or out of order;
            quantiles beyond the limit.

    Example:
        >>> import torch
        >>> norm = QuantileNormalizer(2, name="state", min_range=0.02)
        >>> norm.set_quantiles([0.0, 0.5], [4.0, 0.5])  # the second never moved
        >>> norm(torch.tensor([3.0, 0.51]))
        tensor([0.5000, 1.0000])
        >>> norm.inverse(torch.tensor([0.5, 0.0]))
        tensor([3.0000, 0.5000])
    """

    low: torch.Tensor
    high: torch.Tensor

    def __init__(
        self,
        size: int,
        *,
        name: str,
        min_range: float,
        clip: float | None = None,
        limit: float | None = None,
    ) -> None:
        super().__init__()
        if min_range <= 0:
            raise ConfigError([f"min_range={min_range} must be positive"])
        self.size, self.name, self.min_range = size, name, min_range
        self.clip, self.limit = clip, limit
        self.register_buffer("low", -torch.ones(size))
        self.register_buffer("high", torch.ones(size))

    def set_quantiles(self, low: ArrayLike, high: ArrayLike) -> None:
        """Fix the range from the 1 % and 99 % quantiles of the data.

        Args:
            low: lower quantile, shape (size,), raw units.
            high: upper quantile, shape (size,), raw units.
        """
        lower, upper = (
            torch.as_tensor(bound, dtype=torch.float64).detach().cpu()
            for bound in (low, high)
        )
        for bound in (lower, upper):
            if bound.shape != (self.size,) or not bool(bound.isfinite().all()):
                raise DataError(
                    f"quantiles of {self.name} have shape {tuple(bound.shape)} or hold "
                    f"NaN; {self.size} finite numbers are needed."
                )
        if bool((upper < lower).any()):
            first = int((upper < lower).nonzero()[0])
            raise DataError(
                f"quantiles of {self.name} are out of order at index {first}: "
                f"{float(lower[first]):g} > {float(upper[first]):g}; "
                "give the lower quantile first."
            )
        self._check_limit(torch.stack([lower, upper]))
        middle = (lower + upper) / 2
        half = ((upper - lower) / 2).clamp_min(self.min_range / 2)
        # Of numbers as large as ten million float32 knows no fractions: both ends of
        # such a range would be one number.
        half = half.maximum(middle.abs() * _RELATIVE)
        self.low.copy_(middle - half)
        self.high.copy_(middle + half)

    def _check_limit(self, bounds: torch.Tensor) -> None:
        if self.limit is None or bool((bounds.abs() <= self.limit + TOLERANCE).all()):
            return
        worst = int(bounds.abs().amax(0).argmax())
        low, high = bounds[:, worst].tolist()
        raise DataError(
            f"number {worst} of the {self.name} lies between {low:.4g} and {high:.4g} "
            f"in the data (1 % and 99 % quantiles), but the policy clips it to "
            f"[-{self.limit:g}, {self.limit:g}]; scale the data to that range, or "
            f"build the policy with {self.name}_limit=None."
        )

    def forward(self, raw: torch.Tensor) -> torch.Tensor:
        """Normalise ``raw`` [..., size]."""
        if raw.shape[-1] != self.size:
            raise DataError(
                f"{self.name} has {counted(raw.shape[-1], 'number')}, the policy was "
                f"built for {self.size}; use the data or the task that it was "
                "trained on."
            )
        normalized = 2 * (raw - self.low) / (self.high - self.low) - 1
        if self.clip is None:
            return normalized
        return normalized.clamp(-self.clip, self.clip)

    def inverse(self, normalized: torch.Tensor) -> torch.Tensor:
        """Return raw numbers [..., size] of normalised ones."""
        return self.low + (normalized + 1) * (self.high - self.low) / 2
