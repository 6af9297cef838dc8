"""The learned noise of Flow-Noise's steps, beside a LeRobot policy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import nn

from rlco.policies.nets.mlp import Mlp


def check_range(noise_range: Sequence[float]) -> list[str]:
    """Return what is wrong with a least and a greatest standard deviation.

    Example:
        >>> check_range((0.1, 0.0))
        ['noise_range=[0.1, 0.0] must be two numbers, 0 < least <= greatest']
    """
    if len(noise_range) == 2 and 0 < noise_range[0] <= noise_range[1] < math.inf:
        return []
    given = list(noise_range)
    return [f"noise_range={given} must be two numbers, 0 < least <= greatest"]


class StepNoise(nn.Module):
    """Standard deviation of each number of a step, from the expert's last layer.

    Each step of the chunk has its own state there, so one small network serves all of
    them (ReinFlow, arXiv 2505.22094). Imitation leaves it as it is; exported
    checkpoints do not hold it, as acting needs no noise.

    Args:
        hidden_size: width E of the expert's last layer.
        width: action dimensions, padding included.
        noise_range: least and greatest standard deviation.

    Example:
        >>> noise = StepNoise(16, 7, (0.08, 0.16))
        >>> std = noise(torch.zeros(5, 4, 16))  # the middle of the range, in logarithms
        >>> std.shape, round(std.mean().item(), 2)
        (torch.Size([5, 4, 7]), 0.11)
    """

    def __init__(
        self, hidden_size: int, width: int, noise_range: tuple[float, float]
    ) -> None:
        super().__init__()
        self.noise_range = noise_range
        self.network = Mlp(
            hidden_size, width, hidden=(128, 64), activation="tanh", gain=0.01
        )

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        """Return deviations (..., H, width) of states (..., H, E)."""
        low, high = (math.log(std) for std in self.noise_range)
        share: torch.Tensor = (self.network(state).tanh() + 1) / 2
        return (low + (high - low) * share).exp()
