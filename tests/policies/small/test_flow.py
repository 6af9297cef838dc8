"""The flow policy: chains, densities, reductions, imitation, gradients."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from policy_cases import demonstrations, gradients_are_right, observations, tiny
from scipy import stats
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.errors import ConfigError, DataError
from rlco.policies import Actor, FlowPolicy
from rlco.policies.densities.flow_steps import euler_step, sde_step, step_times

pytestmark = pytest.mark.slow

SAMPLE = ("vla_action", "sample")
LOG_PROB = ("vla_action", "log_probs")
STEP = ("vla_action", "denoise_step")
METHODS = [
    {"method": "flow_noise"},
    {"method": "flow_noise", "noisy_steps": "one"},
    {"method": "flow_sde"},
    {"method": "flow_sde", "noisy_steps": "one"},
    {"method": "fpo"},
]


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


def noisy_steps(policy: FlowPolicy, td: Any) -> tuple[torch.Tensor, torch.Tensor]:
    """Return mean and deviation of all K steps of a batch's chains, one by one."""
    context = policy.network.observe(policy.encoder(td))
    times = step_times(policy.chain.steps).float()
    means, stds = [], []
    for k in range(policy.chain.steps):
        x, time, after = td[SAMPLE][..., k, :, :], times[k], times[k + 1]
        velocity, state = policy.network(context, x, time)
        if policy.chain.method == "flow_sde":
            mean, std = sde_step(x, velocity, time, after, policy.chain.noise_level)
        else:
            mean = euler_step(x, velocity, time, after)
            std = policy.network.noise_std(state)
        means.append(mean)
        stds.append(std)
    return torch.stack(means, -3), torch.stack(stds, -3)


@pytest.mark.parametrize("reduction", ["sum", "mean"])
@pytest.mark.parametrize("method", ["flow_noise", "flow_sde"])
def test_log_probability_is_that_of_the_whole_chain(
    method: str, reduction: str
) -> None:
    policy = tiny("flow", method=method, steps=3, denoise_reduction=reduction)
    td = policy(observations(5))
    chain = td[SAMPLE]
    assert chain.shape == (5, 4, 2, 2)
    start = torch.distributions.Normal(0.0, 1.0).log_prob(chain[:, 0]).sum((-2, -1))
    steps = torch.distributions.Normal(*noisy_steps(policy, td)).log_prob(chain[:, 1:])
    expected = start + steps.sum((-3, -2, -1))
    # RLinf's mean runs over the noise and the three steps.
    expected = expected / 4 if reduction == "mean" else expected
    torch.testing.assert_close(policy.get_dist(td).log_prob(chain), expected)


@pytest.mark.parametrize("method", ["flow_noise", "flow_sde"])
def test_one_noisy_step_alone_counts_and_the_others_are_deterministic(
    method: str,
) -> None:
    policy = tiny("flow", method=method, noisy_steps="one", steps=3)
    td = policy(observations(300))
    chain, which = td[SAMPLE], td[STEP]
    assert which.unique().tolist() == [0, 1, 2]
    context = policy.network.observe(policy.encoder(td))
    times = step_times(3).float()
    mean, std = noisy_steps(policy, td)
    density = torch.distributions.Normal(mean, std).log_prob(chain[:, 1:]).sum((-2, -1))
    expected = density.gather(-1, which.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(policy.get_dist(td).log_prob(chain), expected)
    for k in range(3):
        velocity, _ = policy.network(context, chain[:, k], times[k])
        still = euler_step(chain[:, k], velocity, times[k], times[k + 1])
        gap = (chain[:, k + 1] - still).abs().amax((-2, -1))
        assert (gap[which != k] < 1e-5).all()
        assert (gap[which == k] > 1e-3).all()


@pytest.mark.parametrize("options", METHODS[:4])
def test_ten_thousand_samples_follow_the_density_that_is_evaluated(
    options: dict[str, Any],
) -> None:
    policy = tiny("flow", steps=2, noise_range=(0.2, 0.6), **options)
    with torch.no_grad():
        td = policy(observations(10_000))
        mean, std = noisy_steps(policy, td)
        z = (td[SAMPLE][:, 1:] - mean) / std
    if "noisy_steps" in options:
        z = z[torch.arange(10_000), td[STEP]]
    # Standard normal, each number and step: 10,000 of each are told apart at 2 %.
    for numbers in z.reshape(10_000, -1).unbind(1):
        assert stats.kstest(numbers.numpy(), "norm").pvalue > 1e-4
    first = td[SAMPLE][:, 0].reshape(-1)
    assert stats.kstest(first.numpy(), "norm").pvalue > 1e-4


@pytest.mark.parametrize("options", METHODS[:4])
def test_entropy_is_minus_the_mean_log_probability(options: dict[str, Any]) -> None:
    policy = tiny("flow", steps=2, **options)
    with torch.no_grad():
        td = policy(observations(1).expand(20_000).clone())
        dist = policy.get_dist(td)
        log_prob = dist.log_prob(td[SAMPLE])
    error = 4 * float(log_prob.std()) / math.sqrt(20_000)
    assert float(dist.entropy().mean()) == pytest.approx(
        -float(log_prob.mean()), abs=error
    )


def test_learned_noise_stays_in_its_range_and_depends_on_the_observation() -> None:
    policy = tiny("flow", noise_range=(0.05, 0.3))
    policy.network.noise.head.weight.data.mul_(100)
    td = policy(observations(200))
    _, std = noisy_steps(policy, td)
    assert std.min().item() == pytest.approx(0.05, rel=0.01)
    assert std.max().item() == pytest.approx(0.3, rel=0.01)


def test_fpos_ratio_is_how_much_the_loss_falls() -> None:
    policy = tiny("flow", method="fpo", fpo_draws=3)
    td = policy(observations(4))
    noise, time = td["vla_action", "flow_noise"], td["vla_action", "flow_time"]
    assert noise.shape == (4, 3, 2, 2)

    def loss() -> torch.Tensor:
        context = policy.network.observe(policy.encoder(td))
        total = torch.zeros(4)
        for draw in range(3):
            t = time[:, draw]
            action = td[SAMPLE][:, -1]
            share = t[:, None, None]
            x = share * noise[:, draw] + (1 - share) * action
            velocity, _ = policy.network(context, x, t)
            error = velocity - (noise[:, draw] - action)
            total += error.square().mean((-2, -1)) / 3
        return total

    before = loss()
    for parameter in policy.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    ratio = (policy.get_dist(td).log_prob(td[SAMPLE]) - td[LOG_PROB]).exp()
    torch.testing.assert_close(ratio, (before - loss()).exp())
    with pytest.raises(ConfigError, match="has no entropy"):
        policy.get_dist(td).entropy()


@pytest.mark.parametrize("options", METHODS)
def test_levels_are_sums_or_means_of_each_other(options: dict[str, Any]) -> None:
    policy, found = tiny("flow", **options), {}
    td = policy(observations(3, 5))
    for level in ("token", "action", "chunk"):
        policy.log_prob_level = level
        found[level] = policy.get_dist(td).log_prob(td[SAMPLE])
    assert found["token"].shape == (3, 5, 2, 2)
    share = 2 if options["method"] == "fpo" else 1
    torch.testing.assert_close(found["token"].sum(-1) / share, found["action"])
    torch.testing.assert_close(found["action"].sum(-1) / share, found["chunk"])


@pytest.mark.parametrize("options", METHODS)
def test_without_exploration_it_follows_the_flow_from_zeros(
    options: dict[str, Any],
) -> None:
    policy, td = tiny("flow", steps=3, **options), observations(4)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = policy(td)
    context = policy.network.observe(policy.encoder(td))
    x, times = torch.zeros(4, 2, 2), step_times(3).float()
    for k in range(3):
        x = x - policy.network(context, x, times[k])[0] / 3
    torch.testing.assert_close(td["action"], x.clamp(-1, 1))


def test_raw_actions_are_the_ends_of_chains_in_raw_units() -> None:
    policy = tiny("flow")
    policy.set_normalization(action=([-0.5, 0.0], [0.5, 1.0]))
    td = policy(observations(4, 3))
    raw = td[SAMPLE][..., -1, :, :] / 2 + torch.tensor([0.0, 0.5])
    torch.testing.assert_close(td["action"], raw.clamp(-1, 1))
    torch.testing.assert_close(td["vla_action", "chunk"], td["action"])
    assert set(policy.out_keys) <= set(td.keys(True, True))
    assert isinstance(policy, Actor)


def test_imitation_approaches_the_variance_that_no_velocity_explains() -> None:
    # With v = 0 the error is (e - a)^2, its mean 1 + a^2.
    policy = tiny("flow", imitation_draws=20_000)
    policy.network.velocity.head.weight.data.zero_()
    policy.network.slope.head.weight.data.zero_()
    td = demonstrations(policy, 2)
    expected = 1 + td["vla_action", "chunk"].square().mean(-1)
    found = policy.imitation_loss(td)
    torch.testing.assert_close(found, expected, atol=0.06, rtol=0)


def test_padding_as_rlinfs_weakens_the_loss_by_its_share() -> None:
    # One layer of seeds: 2 real numbers of 32.
    losses = []
    for padded in (None, 32):
        torch.manual_seed(1)
        policy = tiny("flow", padded_size=padded)
        losses.append(policy.imitation_loss(demonstrations(policy, 5)))
    torch.testing.assert_close(losses[1], losses[0] * 2 / 32)


@pytest.mark.parametrize("what", ["imitation", *range(len(METHODS))])
def test_gradients_agree_with_finite_differences(what: Any) -> None:
    options: dict[str, Any] = {} if what == "imitation" else METHODS[what]
    policy = tiny("flow", steps=2, hidden=(4,), noise_range=(0.2, 0.8), **options)
    policy = policy.double()
    td = policy(demonstrations(policy, 2, dtype=torch.float64))

    def compute(module: FlowPolicy) -> torch.Tensor:
        if what == "imitation":
            torch.manual_seed(5)
            return module.imitation_loss(td)
        return module.get_dist(td).log_prob(td[SAMPLE])

    assert gradients_are_right(policy, compute)


def test_imitation_leaves_the_noise_as_it_is() -> None:
    policy = tiny("flow")
    policy.imitation_loss(demonstrations(policy, 5)).sum().backward()
    assert all(p.grad is None for p in policy.network.noise.parameters())
    assert all(p.grad is not None for p in policy.network.velocity.parameters())


def test_what_the_replay_needs_is_asked_for() -> None:
    policy = tiny("flow", noisy_steps="one")
    td = policy(observations(2))
    assert policy.replay_keys == [*policy.in_keys, SAMPLE, STEP]
    with pytest.raises(DataError, match=r"no .*denoise_step"):
        policy.get_dist(td.exclude(STEP))
    with pytest.raises(DataError, match=r"no .*sample"):
        policy.get_dist(observations(2))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "steps=0 must be at least 1"),
        ({"method": "sde"}, "unknown method 'sde'; known: flow_noise, flow_sde, fpo"),
        ({"noisy_steps": "two"}, "unknown noisy_steps 'two'"),
        ({"denoise_reduction": "max"}, "unknown denoise_reduction 'max'"),
        ({"noise_range": (0.2, 0.1)}, "must be two positive numbers in order"),
        ({"noise_level": 0.0}, "noise_level=0.0 must be positive"),
        ({"fpo_draws": 0}, "fpo_draws=0 must be at least 1"),
        ({"imitation_draws": 0}, "imitation_draws=0 must be at least 1"),
        ({"padded_size": 1}, "padded_size=1 must be at least 2"),
        ({"hidden": ()}, "must name at least one layer"),
        ({"log_prob_level": "row"}, "unknown log_prob_level 'row'"),
    ],
)
def test_wrong_options_are_refused(options: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        tiny("flow", **options)
