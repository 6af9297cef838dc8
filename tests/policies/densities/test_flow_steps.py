"""Steps of a flow: by hand, and their marginals on a Gaussian whose flow is known."""

from __future__ import annotations

import math

import pytest
import torch

from rlco.policies.densities.flow_chain import FlowChain
from rlco.policies.densities.flow_matching import draw_times, squared_error
from rlco.policies.densities.flow_steps import sde_step, step_times

MEAN, STD = 0.7, 0.4


def exact(x: torch.Tensor, time: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the velocity of the flow onto N(0.7, 0.4^2), and no state.

    x_t = t e + (1 - t) a is N(m, V) with m = .7 (1 - t), V = t^2 + .16 (1 - t)^2, so
    E[e - a | x_t] = -.7 + (t - .16 (1 - t)) (x - m) / V.
    """
    time = time[..., None, None]
    mean = MEAN * (1 - time)
    variance = time**2 + (STD * (1 - time)) ** 2
    slope = (time - STD**2 * (1 - time)) / variance
    return slope * (x - mean) - MEAN, x


def no_noise(state: torch.Tensor) -> torch.Tensor:
    raise AssertionError("this method learns no noise")


def marginal(steps: int, level: float, *, noisy: bool) -> tuple[float, float]:
    """Return mean and standard deviation of 100,000 chains' ends."""
    chain = FlowChain("flow_sde", steps, "all", level, "sum")
    noise = torch.randn(100_000, 1, 1)
    which = torch.full((100_000,), -1) if noisy else None
    end = chain.draw(exact, no_noise, noise, which)[:, -1]
    return float(end.mean()), float(end.std())


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.5, 1.0])
def test_flow_sde_has_the_marginal_of_the_deterministic_flow(level: float) -> None:
    torch.manual_seed(0)
    mean_ode, std_ode = marginal(100, level, noisy=False)
    mean_sde, std_sde = marginal(100, level, noisy=True)
    # Standard errors .4 / sqrt(100000) = .0013 and .0009; steps of 1 / 100 cost 2 %.
    assert mean_ode == pytest.approx(MEAN, abs=0.005)
    assert mean_sde == pytest.approx(mean_ode, abs=0.007)
    assert std_ode == pytest.approx(STD, rel=0.02)
    assert std_sde == pytest.approx(std_ode, rel=0.025)


def test_with_few_steps_its_noise_makes_up_for_some_of_eulers_narrowing() -> None:
    torch.manual_seed(0)
    _, ode = marginal(4, 1.0, noisy=False)
    _, sde = marginal(4, 1.0, noisy=True)
    # For a linear velocity the deviation is a product of factors; with K = 4, .260.
    assert ode == pytest.approx(0.260, abs=0.003)
    assert ode + 0.05 < sde < STD + 0.01


def test_step_deviations_by_hand() -> None:
    # s sqrt(1/4) with s = .5 sqrt(t / (1 - t)), t = 1 taking 1/4 for 1 - t: s = 1,
    # .5 sqrt 3, .5, .5 / sqrt 3.
    times = step_times(4)
    x = torch.zeros(4, dtype=torch.float64)
    _, std = sde_step(x, x, times[:-1], times[1:], 0.5)
    expected = torch.tensor([0.5, 0.25 * math.sqrt(3), 0.25, 0.25 / math.sqrt(3)])
    torch.testing.assert_close(std, expected.double())


def test_times_of_training_follow_the_shifted_beta() -> None:
    torch.manual_seed(0)
    time = (draw_times((200_000,), torch.zeros(())) - 0.001) / 0.999
    # Beta(1.5, 1): mean 3/5, variance 1.5 / (2.5^2 3.5) = .06857.
    assert time.mean().item() == pytest.approx(0.6, abs=0.003)
    assert time.var().item() == pytest.approx(0.06857, abs=0.001)
    assert time.min() >= 0
    assert time.max() <= 1


def test_squared_error_by_hand() -> None:
    # a = 2, e = -1, t = 1/4: x = -1/4 + 3/2 = 5/4, target e - a = -3; v = x: 4.25^2.
    def velocity(
        x: torch.Tensor, time: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        return x, time

    found = squared_error(
        velocity,
        torch.full((1, 1, 1), 2.0),
        torch.full((1, 1), 0.25),
        torch.full((1, 1, 1, 1), -1.0),
    )
    assert found.item() == pytest.approx(4.25**2)
