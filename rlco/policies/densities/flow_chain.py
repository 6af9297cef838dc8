"""Denoising chains: drawn step by step, and their density, replayed in one pass.

A chain [..., K + 1, H, A] starts with noise and ends with the chunk. What makes its
density is that its steps are Gaussian: by Flow-Noise a learned deviation about the
deterministic step, by Flow-SDE the step of an equivalent stochastic flow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import torch

from rlco.policies.densities.flow_steps import euler_step, sde_step, step_times

FlowMethod = Literal["flow_noise", "flow_sde", "fpo"]
NoisySteps = Literal["all", "one"]
DenoiseReduction = Literal["mean", "sum"]

#: Velocity [B, ..., H, A] and the network's state there, of points [B, ..., H, A] and
#: times that broadcast against [B, ...], for the observations [B].
Velocity = Callable[[torch.Tensor, torch.Tensor], tuple[torch.Tensor, torch.Tensor]]
#: Standard deviation [B, ..., H, A] of Flow-Noise's step of such a state.
NoiseStd = Callable[[torch.Tensor], torch.Tensor]


@dataclass(frozen=True)
class FlowChain:
    """How chains are drawn, and what their log-probability sums up.

    Attributes:
        method: "flow_noise" or "flow_sde"; "fpo" draws without noise in the steps.
        steps: K.
        noisy_steps: whether all steps are noisy, or one of them, drawn anew for each
            decision, while the others are deterministic.
        noise_level: a of Flow-SDE.
        reduction: over the K + 1 terms of a chain: their "sum", its log-density, or
            their "mean", as RLinf has it, by which all ratios are tempered.
    """

    method: FlowMethod
    steps: int
    noisy_steps: NoisySteps
    noise_level: float
    reduction: DenoiseReduction

    def problems(self) -> list[str]:
        """Return what is wrong with the values."""
        found = []
        for name, value, known in (
            ("method", self.method, get_args(FlowMethod)),
            ("noisy_steps", self.noisy_steps, get_args(NoisySteps)),
            ("denoise_reduction", self.reduction, get_args(DenoiseReduction)),
        ):
            if value not in known:
                found.append(f"unknown {name} {value!r}; known: {', '.join(known)}")
        if self.steps < 1:
            found.append(f"steps={self.steps} must be at least 1")
        if not self.noise_level > 0:
            found.append(f"noise_level={self.noise_level} must be positive")
        return found

    def draw(
        self,
        velocity: Velocity,
        noise_std: NoiseStd,
        noise: torch.Tensor,
        noisy: torch.Tensor | None,
    ) -> torch.Tensor:
        """Return chains [B, K + 1, H, A] from their first points.

        Args:
            velocity: at points [B, H, A] and one time.
            noise_std: of Flow-Noise's steps; the other methods do not call it.
            noise: the first points [B, H, A].
            noisy: which step of each chain is noisy [B], -1 for all of them; None:
                no step of any chain.
        """
        x, chain = noise, [noise]
        times = step_times(self.steps).to(x)
        for k in range(self.steps):
            time, after = times[k], times[k + 1]
            still, mean, std = self._step(velocity, noise_std, x, time, after)
            if noisy is None:
                x = still
            else:
                here = ((noisy == k) | (noisy < 0))[..., None, None]
                x = torch.where(here, mean + std * torch.randn_like(x), still)
            chain.append(x)
        return torch.stack(chain, -3)

    def density(
        self,
        velocity: Velocity,
        noise_std: NoiseStd,
        chain: torch.Tensor,
        noisy: torch.Tensor | None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return each number's log-probability and entropy [B, H, A], reduced over K.

        Args:
            velocity: at points [B, K, H, A] and K times, or [B, H, A] and B times.
            noise_std: as in ``draw``.
            chain: [B, K + 1, H, A].
            noisy: the noisy step of each chain [B], where it is one: only that step
                counts. None: all of them.
        """
        times = step_times(self.steps).to(chain)
        if noisy is None:
            x, following = chain[..., :-1, :, :], chain[..., 1:, :, :]
            time, after = times[:-1], times[1:]
        else:
            x, following = _at(chain, noisy), _at(chain, noisy + 1)
            time, after = times[noisy], times[noisy + 1]
        _, mean, std = self._step(velocity, noise_std, x, time, after)
        log_prob, entropy = _log_normal(following, mean, std), _entropy(std)
        if noisy is not None:
            return log_prob, entropy
        first = chain[..., :1, :, :]
        one = torch.ones_like(first)
        start = _log_normal(first, torch.zeros_like(first), one)
        return self._reduce(start, log_prob), self._reduce(_entropy(one), entropy)

    def _step(
        self,
        velocity: Velocity,
        noise_std: NoiseStd,
        x: torch.Tensor,
        time: torch.Tensor,
        after: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return where a step leads without noise, and its mean and deviation with."""
        v, state = velocity(x, time)
        time, after = time[..., None, None], after[..., None, None]
        still = euler_step(x, v, time, after)
        if self.method == "flow_noise":
            return still, still, noise_std(state)
        return still, *sde_step(x, v, time, after, self.noise_level)

    def _reduce(self, start: torch.Tensor, steps: torch.Tensor) -> torch.Tensor:
        total = torch.cat([start, steps], -3).sum(-3)
        return total / (self.steps + 1) if self.reduction == "mean" else total


def _at(chain: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    """Return one point [B, H, A] of each chain."""
    index = step[..., None, None, None].expand(*step.shape, 1, *chain.shape[-2:])
    return chain.gather(-3, index).squeeze(-3)


def _log_normal(x: torch.Tensor, mean: torch.Tensor, std: torch.Tensor) -> torch.Tensor:
    """Return the log-density of x, each number alone."""
    z = (x - mean) / std
    return -0.5 * z.square() - std.log() - 0.5 * math.log(2 * math.pi)


def _entropy(std: torch.Tensor) -> torch.Tensor:
    return std.log() + 0.5 * (1 + math.log(2 * math.pi))
