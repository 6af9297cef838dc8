"""The multi-layer perceptron of the policy and of the value network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from torch import nn

from rlco.errors import ConfigError

Activation = Literal["silu", "tanh"]
_ACTIVATIONS: dict[str, type[nn.Module]] = {"silu": nn.SiLU, "tanh": nn.Tanh}


class _OutputLinear(nn.Linear):
    """A last layer whose gain alone decides the size of the first outputs."""

    def __init__(self, in_features: int, out_features: int, gain: float) -> None:
        self.gain = gain
        super().__init__(in_features, out_features)

    def reset_parameters(self) -> None:
        nn.init.orthogonal_(self.weight, self.gain)
        nn.init.zeros_(self.bias)


class Mlp(nn.Module):
    """Linear layers with an activation, and layer norm if wanted, between them.

    It computes in the precision of its weights and returns at least float32, so that
    what is computed from its output (log-probabilities, losses) is not rounded to
    bfloat16.

    Args:
        in_size: input dimension.
        out_size: output dimension.
        hidden: width of each hidden layer.
        activation: "silu" or "tanh".
        layer_norm: normalise before each activation.
        gain: orthogonal gain of the last layer, whose bias starts at 0.

    Raises:
        ConfigError: an activation that is not known, or a width below 1.

    Example:
        >>> import torch
        >>> network = Mlp(3, 2, hidden=(8,), gain=0.01).bfloat16()
        >>> network(torch.randn(5, 3)).dtype
        torch.float32
    """

    def __init__(
        self,
        in_size: int,
        out_size: int,
        *,
        hidden: Sequence[int] = (256, 256),
        activation: Activation = "silu",
        layer_norm: bool = False,
        gain: float = 1.0,
    ) -> None:
        super().__init__()
        problems = []
        if activation not in _ACTIVATIONS:
            known = ", ".join(_ACTIVATIONS)
            problems.append(f"unknown activation {activation!r}; known: {known}")
        if min((in_size, *hidden, out_size)) < 1:
            widths = (in_size, *hidden, out_size)
            problems.append(f"layer widths {widths} must be positive")
        if problems:
            raise ConfigError(problems)
        layers: list[nn.Module] = []
        width = in_size
        for units in hidden:
            layers.append(nn.Linear(width, units))
            if layer_norm:
                layers.append(nn.LayerNorm(units))
            layers.append(_ACTIVATIONS[activation]())
            width = units
        self.trunk = nn.Sequential(*layers)
        self.head = _OutputLinear(width, out_size, gain)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Return outputs [..., out_size] of features [..., in_size]."""
        out: torch.Tensor = self.head(self.trunk(features.to(self.head.weight.dtype)))
        return out.to(torch.promote_types(out.dtype, torch.float32))
