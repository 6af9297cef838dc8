"""One denoising step of a flow: its mean and its standard deviation.

Time runs from 1 (noise) to 0 (action), as in pi0 and LeRobot: the straight path of a
noise ``e`` and an action ``a`` is ``x_t = t e + (1 - t) a``, its velocity ``e - a``.
All functions take times that broadcast against ``x``.
"""

from __future__ import annotations

import torch


def step_times(steps: int) -> torch.Tensor:
    """Return the K + 1 times between K even steps, from 1 to 0, float64.

    Example:
        >>> step_times(4)
        tensor([1.0000, 0.7500, 0.5000, 0.2500, 0.0000], dtype=torch.float64)
    """
    return torch.linspace(1.0, 0.0, steps + 1, dtype=torch.float64)


def euler_step(
    x: torch.Tensor, velocity: torch.Tensor, time: torch.Tensor, after: torch.Tensor
) -> torch.Tensor:
    """Return the next point of the deterministic flow, ``x - (t - t') v``."""
    return x - (time - after) * velocity


def sde_step(
    x: torch.Tensor,
    velocity: torch.Tensor,
    time: torch.Tensor,
    after: torch.Tensor,
    noise_level: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    r"""Return mean and standard deviation of a step of Flow-SDE.

    Noise that leaves the marginals of the flow as they are, and the drift that makes up
    for it (Flow-GRPO, Liu et al., arXiv 2505.05470; piRL, arXiv 2510.25889):

    .. math::
        \mu = x - \delta \left[v + \tfrac{s^2}{2t} (x + (1 - t) v)\right], \quad
        \sigma = s \sqrt{\delta}, \quad s = a \sqrt{t / (1 - t)}

    with :math:`\delta = t - t'`. At t = 1, where s has no bound, 1 - t' takes the place
    of 1 - t.

    Args:
        x: points [...].
        velocity: v [...].
        time: t, positive.
        after: t'.
        noise_level: a.

    Example:
        >>> one, zero = torch.tensor(1.0), torch.tensor(0.0)
        >>> sde_step(zero, one, one, torch.tensor(0.75), 0.5)  # s = 1, v = 1
        (tensor(-0.2500), tensor(0.5000))
    """
    delta = time - after
    rest = torch.where(time < 1, 1 - time, 1 - after)
    variance = noise_level**2 * time / rest
    drift = velocity + variance / (2 * time) * (x + (1 - time) * velocity)
    return x - delta * drift, (variance * delta).sqrt().expand_as(x)
