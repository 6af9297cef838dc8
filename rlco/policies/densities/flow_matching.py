"""The loss of flow matching at given times and noises."""

from __future__ import annotations

import torch

from rlco.policies.densities.flow_chain import Velocity


def draw_times(shape: tuple[int, ...], like: torch.Tensor) -> torch.Tensor:
    """Draw times of training, ``0.999 b + 0.001`` with b ~ Beta(1.5, 1), as pi0 does.

    More of them near 1, the noise: there the velocity hangs on the observation.
    """
    # The distribution function of Beta(1.5, 1) is b ** 1.5.
    uniform = torch.rand(shape, dtype=like.dtype, device=like.device)
    return 0.999 * uniform.pow(1 / 1.5) + 0.001


def squared_error(
    velocity: Velocity,
    actions: torch.Tensor,
    time: torch.Tensor,
    noise: torch.Tensor,
) -> torch.Tensor:
    r"""Return each number's squared error of the velocity.

    .. math:: (v_\theta(t \epsilon + (1 - t) a, t) - (\epsilon - a))^2

    Lipman et al., arXiv 2210.02747, on straight paths; time as in pi0.

    Args:
        velocity: v.
        actions: a, normalised chunks [B, H, A].
        time: t [B, D], D of them for each chunk.
        noise: epsilon [B, D, H, A].

    Returns:
        [B, D, H, A].
    """
    share, actions = time[..., None, None], actions.unsqueeze(-3)
    found, _ = velocity(share * noise + (1 - share) * actions, time)
    return (found - (noise - actions)).square()
