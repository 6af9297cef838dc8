"""A small causal transformer over the tokens of an action chunk."""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import nn
from torch.nn import functional

from rlco.errors import ConfigError

_SPREAD = 0.2  # of the first bell, where the tokens lie on [-1, 1]
#: Keys and values [N, heads, positions, width / heads] of each layer.
Cache = list[tuple[torch.Tensor, torch.Tensor]]


class _Block(nn.Module):
    """Attention to earlier positions, then a perceptron, each normalised first."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_attention = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.norm_perceptron = nn.LayerNorm(width)
        self.perceptron = nn.Sequential(
            nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return [N, P, width] of all positions at once."""
        query, key, value = self._split(x)
        mixed = functional.scaled_dot_product_attention(
            query, key, value, is_causal=True
        )
        return self._rest(x, mixed)

    def step(
        self, x: torch.Tensor, cache: tuple[torch.Tensor, torch.Tensor], position: int
    ) -> torch.Tensor:
        """Return [N, 1, width] of one position; its key and value join the cache."""
        query, key, value = self._split(x)
        keys, values = cache
        keys[:, :, position], values[:, :, position] = key[:, :, 0], value[:, :, 0]
        mixed = functional.scaled_dot_product_attention(
            query, keys[:, :, : position + 1], values[:, :, : position + 1]
        )
        return self._rest(x, mixed)

    def _split(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        joint = self.query_key_value(self.norm_attention(x))
        heads: torch.Tensor = joint.unflatten(-1, (3, self.heads, -1))
        return heads.permute(2, 0, 3, 1, 4).unbind(0)

    def _rest(self, x: torch.Tensor, mixed: torch.Tensor) -> torch.Tensor:
        x = x + self.out(mixed.transpose(1, 2).flatten(-2))
        rest: torch.Tensor = x + self.perceptron(self.norm_perceptron(x))
        return rest


class CausalTransformer(nn.Module):
    """Token logits, each of a position given a context and the tokens before it.

    ``forward`` evaluates given tokens in one pass; ``start`` and ``step`` draw one
    token after the other from the cached keys and values of the earlier ones. Both
    compute the same function.

    Tokens are places on a line, and their logits are those of a bell around a mean,
    plus free ones. The mean is linear in features that no norm bounds: free logits
    alone know the numbers that were demonstrated, and none beyond them. Embedding and
    free logits start smooth over the tokens, so that a few demonstrations teach all
    bins near them, and may become anything.

    Args:
        tokens: size of the vocabulary.
        positions: tokens P of a sequence.
        width: features of a position.
        layers: blocks.
        heads: attention heads; they divide the width.
        context: dimension of a context. Each position reads it through its own gates,
            so that one small layer can distinguish all of them.

    Raises:
        ConfigError: sizes below 1, or heads that do not divide the width.

    Example:
        >>> network = CausalTransformer(8, 3, width=16, layers=1, heads=2, context=9)
        >>> logits, first = network(torch.zeros(5, 9), torch.zeros(5, 3).long())
        >>> logits.shape, first.shape
        (torch.Size([5, 3, 8]), torch.Size([5, 16]))
    """

    def __init__(
        self,
        tokens: int,
        positions: int,
        *,
        width: int,
        layers: int,
        heads: int,
        context: int,
    ) -> None:
        super().__init__()
        if min(tokens, positions, width, layers, heads) < 1 or width % heads:
            raise ConfigError(
                [
                    f"width={width}, layers={layers} and heads={heads} must be "
                    "positive, and heads must divide width"
                ]
            )
        self.embedding = nn.Parameter(torch.empty(tokens, width))
        self.place = nn.Parameter(torch.empty(positions, width))
        self.gate = nn.Parameter(torch.empty(positions, context))
        self.read = nn.Linear(context, width)
        self.heads = heads
        self.blocks = nn.ModuleList(_Block(width, heads) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Parameter(torch.empty(tokens, width))
        self.mean = nn.Linear(width, 1)
        self.sharpness = nn.Linear(width, 1)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draw the parameters that belong to no layer."""
        with torch.no_grad():
            for weight in (self.embedding, self.head):
                weight.copy_(_smooth(*weight.shape))
            self.head.mul_(0.1)  # near even at first
            self.sharpness.weight.zero_()
            self.sharpness.bias.fill_(-2.0 * math.log(_SPREAD))
            self.place.normal_(0.0, 0.5)
            self.gate.normal_(1.0, 1.0)

    def forward(
        self,
        context: torch.Tensor,
        tokens: torch.Tensor,
        hidden: torch.Tensor | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Evaluate sequences in one pass.

        Args:
            context: what all positions know [N, context].
            tokens: the sequences [N, P].
            hidden: in which sequences no position is shown a token, bool [N].

        Returns:
            Logits [N, P, vocabulary], at least float32, and the last layer's features
            [N, width] of the position that predicts the first token: it has read no
            token, so a value may be read from it.
        """
        shown = self.embedding[tokens[:, :-1]]
        if hidden is not None:
            shown = torch.where(hidden[:, None, None], torch.zeros_like(shown), shown)
        x = functional.pad(shown, (0, 0, 1, 0)) + self._told(context, tokens.shape[1])
        for block in self.blocks:
            x = block(x)
        normal = self.norm(x)
        return self._logits(x, normal), normal[:, 0]

    def start(self, context: torch.Tensor) -> Cache:
        """Return empty caches for sequences with these contexts."""
        positions, width = self.place.shape
        shape = (len(context), self.heads, positions, width // self.heads)
        empty = self.place.new_empty
        return [(empty(shape), empty(shape)) for _ in self.blocks]

    def step(
        self,
        context: torch.Tensor,
        last: torch.Tensor | None,
        position: int,
        caches: Cache,
    ) -> torch.Tensor:
        """Return the logits [N, vocabulary] of one position.

        Args:
            context: as in ``forward``.
            last: the tokens before it [N]; None at position 0.
            position: which.
            caches: what ``start`` returned; positions before it have been through.
        """
        gated = context.to(self.gate.dtype) * self.gate[position]
        x = self.read(gated) + self.place[position]
        if last is not None:
            x = x + self.embedding[last]
        x = x.unsqueeze(1)
        for block, cache in zip(self.blocks, caches, strict=True):
            x = cast(_Block, block).step(x, cache, position)
        return self._logits(x[:, 0], self.norm(x[:, 0]))

    def _told(self, context: torch.Tensor, positions: int) -> torch.Tensor:
        """Return what the first positions know before any token [N, P, width]."""
        gated = context.to(self.gate.dtype).unsqueeze(1) * self.gate[:positions]
        read: torch.Tensor = self.read(gated) + self.place[:positions]
        return read

    def _logits(self, x: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """Return logits, at least float32, of features before and after the norm."""
        free = functional.linear(normal, self.head)
        precise = torch.promote_types(free.dtype, torch.float32)
        line = torch.linspace(
            -1.0, 1.0, len(self.head), dtype=precise, device=free.device
        )
        away = line - self.mean(x).to(precise)
        sharpness = self.sharpness(normal).to(precise).exp()
        logits: torch.Tensor = free.to(precise) - 0.5 * sharpness * away**2
        return logits


def _smooth(tokens: int, width: int) -> torch.Tensor:
    """Draw waves of random frequency and phase over the tokens [tokens, width]."""
    place = torch.linspace(-1.0, 1.0, tokens).unsqueeze(-1)
    frequency = 3.0 * torch.randn(width)
    phase = 2 * torch.pi * torch.rand(width)
    return (frequency * place + phase).sin()
