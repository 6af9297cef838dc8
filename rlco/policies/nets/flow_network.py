"""The velocity of a flow over action chunks, and the noise of its steps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import nn

from rlco.policies.nets.mlp import Mlp

#: Sines and cosines that tell the time to the network; the longest waves last 4.
TIME_FEATURES = 32
PERIODS = (4e-3, 4.0)


def time_features(time: torch.Tensor) -> torch.Tensor:
    """Return sines and cosines [..., TIME_FEATURES] of times [...], as pi0 has them."""
    low, high = (math.log(period) for period in PERIODS)
    count = TIME_FEATURES // 2
    period = torch.linspace(low, high, count, dtype=time.dtype, device=time.device)
    angle = 2 * math.pi * time.unsqueeze(-1) / period.exp()
    return torch.cat([angle.sin(), angle.cos()], -1)


class FlowNetwork(nn.Module):
    """Velocity v(x, t | context) and, learned apart, the noise of Flow-Noise's steps.

    The velocity is a perceptron's output and a multiple of x that depends on the time
    alone: the flow onto a narrow Gaussian needs just that, ``(t - s^2 (1 - t)) / (t^2 +
    s^2 (1 - t)^2)``, and a perceptron alone learns such a product slowly.

    The context is computed once a decision, the velocity once a denoising step. The
    noise reads the last hidden layer of the velocity, as the chain's does in ReinFlow
    (Zhang et al., arXiv 2505.22094); imitation leaves it as it is.

    Args:
        features: dimension of the observation's feature vector.
        shape: steps H and action dimensions A of a chunk.
        hidden: width of each hidden layer; the last is the context's too.
        noise_range: least and greatest standard deviation.

    Example:
        >>> network = FlowNetwork(3, (4, 7), hidden=(16,), noise_range=(0.08, 0.16))
        >>> context = network.observe(torch.zeros(5, 3))
        >>> velocity, state = network(context, torch.zeros(5, 4, 7), torch.ones(5))
        >>> velocity.shape, network.noise_std(state).shape
        (torch.Size([5, 4, 7]), torch.Size([5, 4, 7]))
    """

    def __init__(
        self,
        features: int,
        shape: tuple[int, int],
        *,
        hidden: Sequence[int],
        noise_range: tuple[float, float],
    ) -> None:
        super().__init__()
        self.shape = shape
        self.noise_range = noise_range
        size, width = math.prod(shape), hidden[-1]
        self.observe = Mlp(features, width, hidden=hidden[:-1] or hidden)
        self.velocity = Mlp(size + TIME_FEATURES + width, size, hidden=hidden, gain=0.1)
        self.slope = Mlp(TIME_FEATURES, size, hidden=(64,), gain=0.1)
        self.noise = Mlp(width, size, hidden=(64,), activation="tanh", gain=0.01)

    def forward(
        self, context: torch.Tensor, x: torch.Tensor, time: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the velocity [B, ..., H, A], at least float32, and the hidden state.

        Args:
            context: [B, width].
            x: points [B, ..., H, A].
            time: broadcasts against [B, ...].
        """
        flat = x.flatten(-2)
        time = time.to(flat.dtype).expand(flat.shape[:-1])
        while context.ndim < flat.ndim:
            context = context.unsqueeze(-2)
        context = context.to(flat.dtype).expand(*flat.shape[:-1], -1)
        clock = time_features(time)
        read = torch.cat([flat, clock, context], -1)
        head = self.velocity.head
        state = self.velocity.trunk(read.to(head.weight.dtype))
        velocity = head(state)
        velocity = velocity.to(torch.promote_types(velocity.dtype, torch.float32))
        velocity = velocity + flat * self.slope(clock)
        return velocity.unflatten(-1, self.shape), state

    def noise_std(self, state: torch.Tensor) -> torch.Tensor:
        """Return the standard deviation [..., H, A] of a step from its hidden state.

        The logarithm of the variance goes from one end of the range to the other with
        a hyperbolic tangent, as in piRL (arXiv 2510.25889).
        """
        low, high = (math.log(std) for std in self.noise_range)
        share = (self.noise(state).tanh() + 1) / 2
        std: torch.Tensor = (low + (high - low) * share).exp()
        return std.view(*std.shape[:-1], *self.shape)
