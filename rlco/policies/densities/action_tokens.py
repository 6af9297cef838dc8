"""Normalised actions as tokens, by TorchRL's tokenizer."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn
from torchrl.data.vla import VocabTailActionTokenizer

from rlco.errors import ConfigError


class ActionTokens(nn.Module):
    """Each normalised action number as one of ``bins`` tokens.

    TorchRL's :class:`~torchrl.data.vla.VocabTailActionTokenizer`, which has OpenVLA's
    edges (``bins`` of them, evenly from -1 to 1) and OpenVLA's order: token 0 is the
    upper end. ``scale`` stretches the edges to [-scale, scale]. What lies outside is
    clipped; in between the error is at most scale / (bins - 1).

    Its numbers stay float32 (float64) where a policy is cast to bfloat16: bins so
    narrow would run together.

    Args:
        bins: tokens a number.
        scale: the outermost edges, in the normalised action space.
        noise_std: standard deviation of the noise behind ``labels``.

    Attributes:
        labels: what imitation of each token aims at, shape (bins, bins): how likely
            each token is once noise is added to that one's number; the identity
            without noise.

    Raises:
        ConfigError: fewer than 2 bins, a range that is not positive, negative noise.

    Example:
        >>> tokens = ActionTokens(256)
        >>> tokens.encode(torch.tensor([-2.0, 0.0, 0.5]))
        tensor([255, 128,  64])
        >>> tokens.decode(torch.tensor([255, 128, 64]))
        tensor([-0.9961,  0.0000,  0.5020])
    """

    labels: torch.Tensor

    def __init__(
        self, bins: int = 256, scale: float = 1.0, noise_std: float = 0.0
    ) -> None:
        super().__init__()
        problems = []
        if bins < 2:
            problems.append(f"bins={bins} must be at least 2")
        if not scale > 0:
            problems.append(f"bin_range={scale} must be positive")
        if noise_std < 0:
            problems.append(f"noise_std={noise_std} must not be negative")
        if problems:
            raise ConfigError(problems)
        self.bins, self.scale = bins, scale
        self.tokenizer = VocabTailActionTokenizer(bins)
        labels = self._blurred(noise_std) if noise_std else torch.eye(bins)
        self.register_buffer("labels", labels, persistent=False)

    def _apply(self, fn: Any, recurse: bool = True) -> ActionTokens:
        def move(numbers: torch.Tensor) -> torch.Tensor:
            moved: torch.Tensor = fn(numbers)
            narrow = moved.is_floating_point() and moved.dtype.itemsize < 4
            return numbers.to(moved.device) if narrow else moved

        # torch declares no types for this method.
        super()._apply(move, recurse)  # type: ignore[no-untyped-call]
        return self

    def encode(self, normalized: torch.Tensor) -> torch.Tensor:
        """Return tokens, int64, of normalised numbers; same shape."""
        tokens: torch.Tensor = self.tokenizer.encode(normalized / self.scale)
        return tokens

    def decode(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return the middles of the tokens' bins; same shape."""
        middles: torch.Tensor = self.tokenizer.decode(tokens)
        return middles * self.scale

    def _blurred(self, std: float) -> torch.Tensor:
        r"""Return how likely each token is once noise is added to another's number.

        .. math:: P_{ij} = P(\mathrm{encode}(x_i + \sigma z) = j), \quad z \sim N(0, 1)

        with x_i the middle of token i's bin; token 0, which only numbers at the upper
        end or beyond it have, stands there.
        """
        middles = self.decode(torch.arange(self.bins))
        middles[0] = self.scale
        edges = self.tokenizer.bins * self.scale
        below = torch.special.ndtr((edges - middles.unsqueeze(-1)) / std)
        # The outermost bins also take what is clipped into them.
        first, last = below[:, 1:2], 1 - below[:, -1:]
        inner = below[:, 2:] - below[:, 1:-1]
        return torch.cat([first, inner, last], dim=-1).flip(-1)
