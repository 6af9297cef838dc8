"""The token policy: bins, causality, cached sampling, densities, gradients."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
import torch
from policy_cases import demonstrations, gradients_are_right, observations, tiny
from scipy import stats
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.errors import ConfigError, DataError, RlcoError
from rlco.policies import Actor, TokenPolicy
from rlco.policies.densities.action_tokens import ActionTokens
from rlco.policies.small.token import _drawn

SAMPLE = ("vla_action", "sample")
LOG_PROB = ("vla_action", "log_probs")


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


def test_bins_are_openvlas_stretched_to_the_range() -> None:
    # Five edges from -2 to 2, one apart; token = 5 - (number of edges at or below x).
    tokens = ActionTokens(5, scale=2.0)
    x = torch.tensor([-9.0, -2.0, -1.5, -0.2, 0.0, 1.99, 2.0, 9.0])
    assert tokens.encode(x).tolist() == [4, 4, 4, 3, 2, 1, 0, 0]
    # The four middles; tokens 0 and 1 share the uppermost.
    assert tokens.decode(torch.arange(5)).tolist() == [1.5, 1.5, 0.5, -0.5, -1.5]


def test_within_the_range_the_rounding_error_is_half_a_bin() -> None:
    tokens = ActionTokens(256, scale=1.5)
    x = torch.linspace(-1.5, 1.5, 1001)
    error = (tokens.decode(tokens.encode(x)) - x).abs().max()
    assert error.item() == pytest.approx(1.5 / 255, rel=1e-3)


# Eight edges from -1.2 to 1.2; token i has the middle 1.2 (8 - 2 i) / 7, 0 the end.
@pytest.mark.parametrize(("token", "x"), [(7, -7.2 / 7), (3, 2.4 / 7), (0, 1.2)])
def test_blurred_labels_are_the_distribution_of_noisy_tokens(
    token: int, x: float
) -> None:
    tokens = ActionTokens(8, scale=1.2, noise_std=0.4)
    found = tokens.labels[token]
    noisy = x + 0.4 * torch.randn(100_000)
    expected = torch.bincount(tokens.encode(noisy), minlength=8) / 100_000
    # Standard error of a share: at most .5 / sqrt(100000) = .0016.
    torch.testing.assert_close(found, expected, atol=0.006, rtol=0)
    assert found.sum().item() == pytest.approx(1.0)


def test_bins_stay_apart_where_the_network_is_bfloat16() -> None:
    policy = tiny("token", bins=256).bfloat16()
    x = torch.linspace(-1, 1, 1001)
    assert policy.network.head.dtype == torch.bfloat16
    apart = ActionTokens(256, policy.tokens.scale)
    assert torch.equal(policy.tokens.encode(x), apart.encode(x))
    assert policy.tokens.labels.dtype == torch.float32


def test_a_token_depends_on_earlier_tokens_alone() -> None:
    policy = tiny("token")
    td = policy(observations(1))
    logits, first = policy._evaluate(policy.features(td), td[SAMPLE])
    for position in range(4):
        changed = td[SAMPLE].flatten(1).clone()
        changed[:, position] = (changed[:, position] + 1) % 6
        other, same = policy._evaluate(policy.features(td), changed.view(1, 2, 2))
        difference = (other - logits).abs().amax(-1).flatten()
        assert (difference[: position + 1] == 0).all()
        assert (difference[position + 1 :] > 1e-4).all()
        assert torch.equal(same, first)
    torch.testing.assert_close(policy.first_state(td), first)


@pytest.mark.parametrize("temperature", [0.7, 1.6])
def test_ten_thousand_samples_come_as_often_as_evaluation_says(
    temperature: float,
) -> None:
    policy = tiny("token", bins=3, chunk=1, temperature=temperature)
    policy.network.head.data.mul_(0.3)  # no outcome is too rare to be counted
    policy.network.sharpness.bias.data.fill_(-4.0)
    one = observations(1)
    sequences = torch.tensor(list(itertools.product(range(3), repeat=2))).view(9, 1, 2)
    td = one.expand(9).clone()
    td[SAMPLE] = sequences
    probability = policy.get_dist(td).log_prob(td[SAMPLE]).exp()
    assert probability.sum().item() == pytest.approx(1.0, abs=1e-5)
    drawn = policy(one.expand(10_000).clone())[SAMPLE].flatten(1)
    counts = torch.bincount(3 * drawn[:, 0] + drawn[:, 1], minlength=9)
    expected = 10_000 * probability.double() / probability.double().sum()
    assert expected.min() > 5  # for the chi-squared test to hold
    assert stats.chisquare(counts.numpy(), expected.detach().numpy()).pvalue > 1e-3


def test_each_of_256_tokens_is_drawn_as_often_as_its_probability_says() -> None:
    chances = torch.linspace(0.0, 3.0, 256).softmax(-1)
    counts = torch.bincount(_drawn(chances.expand(200_000, -1)), minlength=256)
    expected = 200_000 * chances.double() / chances.double().sum()
    assert expected.min() > 5  # for the chi-squared test to hold
    assert stats.chisquare(counts.numpy(), expected.numpy()).pvalue > 1e-3


def test_a_token_of_no_probability_is_never_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(torch, "rand_like", torch.zeros_like)  # the smallest there is
    assert _drawn(torch.tensor([[0.0, 1.0, 0.0]])).tolist() == [1]


def test_logits_are_a_bell_around_a_mean_and_free_ones() -> None:
    network = tiny("token", bins=5).network
    network.mean.weight.data.zero_()
    network.mean.bias.data.fill_(0.25)
    network.sharpness.bias.data.fill_(math.log(8.0))
    network.head.data.zero_()
    logits, _ = network(torch.randn(2, 8), torch.zeros(2, 4, dtype=torch.int64))
    # Five tokens at -1, -0.5, 0, 0.5 and 1.
    bell = [-4.0 * (place - 0.25) ** 2 for place in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    torch.testing.assert_close(logits, torch.tensor(bell).expand(2, 4, 5))


def test_a_mean_goes_on_beyond_what_was_seen() -> None:
    network = tiny("token", bins=5).network
    network.gate.data.fill_(1.0)  # one straight line into the residual stream
    tokens, way = torch.zeros(3, 4, dtype=torch.int64), torch.randn(1, 8)
    far = network(way * torch.tensor([[1e3], [2e3], [3e3]]), tokens)[0].detach()
    # Of the bell, which has the form -s (x - m)^2 / 2, the slope over x is s m.
    slope = (far[..., -1] - far[..., 0])[:, 0] * network.sharpness.bias.exp().pow(-1)
    steps = slope.diff().abs()
    assert steps[0] > 1.0
    torch.testing.assert_close(steps[0], steps[1], rtol=0.05, atol=0.0)


def test_the_rollouts_log_probability_is_the_evaluations() -> None:
    policy = tiny("token", chunk=4, action_size=7, bins=256, width=32, layers=2)
    td = policy(observations(50))
    found = policy.get_dist(td).log_prob(td[SAMPLE])
    torch.testing.assert_close(found, td[LOG_PROB], atol=2e-5, rtol=0)


def test_a_policy_that_diverged_draws_nothing() -> None:
    policy = tiny("token")
    policy.network.head.data[1, 0] = math.nan
    with pytest.raises(RlcoError, match="training diverged"):
        policy(observations(3))


def test_temperature_divides_the_logits() -> None:
    policy = tiny("token")
    td = policy(observations(3))
    logits, _ = policy._evaluate(policy.features(td), td[SAMPLE])
    policy.temperature = 1.7
    scaled = torch.log_softmax(logits / 1.7, -1)
    expected = scaled.gather(-1, td[SAMPLE].unsqueeze(-1)).sum((-3, -2, -1))
    torch.testing.assert_close(policy.get_dist(td).log_prob(td[SAMPLE]), expected)


def test_levels_are_sums_of_each_other() -> None:
    policy, found = tiny("token"), {}
    td = policy(observations(3, 5))
    for level in ("token", "action", "chunk"):
        policy.log_prob_level = level
        dist = policy.get_dist(td)
        found[level] = dist.log_prob(td[SAMPLE])
        assert dist.entropy().shape == found[level].shape
    assert found["token"].shape == (3, 5, 2, 2)
    torch.testing.assert_close(found["token"].sum(-1), found["action"])
    torch.testing.assert_close(found["action"].sum(-1), found["chunk"])


def test_entropy_along_samples_is_minus_the_mean_log_probability() -> None:
    policy = tiny("token")
    td = policy(observations(1).expand(20_000).clone())
    dist = policy.get_dist(td)
    log_prob = dist.log_prob(td[SAMPLE])
    error = 4 * float(log_prob.std()) / math.sqrt(20_000)
    assert float(dist.entropy().mean()) == pytest.approx(
        -float(log_prob.mean()), abs=error
    )


def test_without_exploration_each_token_is_the_likeliest() -> None:
    policy, td = tiny("token"), observations(4)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = policy(td)
        again = policy(td.clone())
    logits, _ = policy._evaluate(policy.features(td), td[SAMPLE])
    assert torch.equal(td[SAMPLE], logits.argmax(-1))
    assert torch.equal(td["action"], again["action"])


def test_raw_actions_are_the_bins_middles_in_raw_units() -> None:
    policy = tiny("token", bins=6, bin_range=2.0)
    policy.set_normalization(action=([-0.5, 0.0], [0.5, 1.0]))
    td = policy(observations(20))
    # Middles from -1.6 to 1.6 in steps of .8, from token 5 down; 0 repeats 1.
    middle = 1.6 - 0.8 * (td[SAMPLE] - 1).clamp_min(0)
    raw = middle / 2 + torch.tensor([0.0, 0.5])
    torch.testing.assert_close(td["action"], raw.clamp(-1, 1))
    torch.testing.assert_close(td["vla_action", "chunk"], td["action"])
    assert set(policy.out_keys) <= set(td.keys(True, True))
    assert isinstance(policy, Actor)


@pytest.mark.parametrize("noise_std", [0.0, 0.3])
def test_imitation_by_hand(noise_std: float) -> None:
    # Even logits: every label costs log(6), blurred or not.
    policy = tiny("token", noise_std=noise_std)
    policy.network.head.data.zero_()
    policy.network.sharpness.bias.data.fill_(-torch.inf)
    td = demonstrations(policy, 3)
    expected = torch.full((3, 2), math.log(6))
    torch.testing.assert_close(policy.imitation_loss(td), expected)


def test_imitation_puts_noise_on_the_tokens_before_and_on_the_label() -> None:
    # The first token has none before it: its labels alone are blurred, by rights.
    policy = tiny("token", noise_std=0.5, hidden_share=0.0, chunk=1)
    td = demonstrations(policy, 1)
    losses = torch.stack([policy.imitation_loss(td) for _ in range(8)])
    assert losses.unique().numel() > 1
    policy.network.embedding.data.zero_()
    losses = torch.stack([policy.imitation_loss(td) for _ in range(8)])
    torch.testing.assert_close(losses, losses[:1].expand_as(losses))


def test_hidden_tokens_are_imitated_from_the_observation_alone() -> None:
    plain: dict[str, Any] = {"noise_std": 0.0, "hidden_share": 0.0}
    seen, unseen = (
        tiny("token", **plain),
        tiny("token", **plain | {"hidden_share": 1.0}),
    )
    unseen.load_state_dict(seen.state_dict())
    td = demonstrations(seen, 3)
    found = unseen.imitation_loss(td)
    assert not torch.allclose(found, seen.imitation_loss(td))
    # Tokens whose embeddings are nothing tell as little.
    seen.network.embedding.data.zero_()
    torch.testing.assert_close(found, seen.imitation_loss(td))


def test_plain_imitation_is_minus_the_mean_log_probability_of_the_tokens() -> None:
    policy = tiny("token", noise_std=0.0, hidden_share=0.0, log_prob_level="action")
    td = demonstrations(policy, 4)
    loss = policy.imitation_loss(td)
    td[SAMPLE] = policy.tokens.encode(td["vla_action", "chunk"])
    torch.testing.assert_close(loss, -policy.get_dist(td).log_prob(td[SAMPLE]) / 2)


def test_blurred_imitation_approaches_the_plain_one() -> None:
    plain, blurred = (
        tiny("token", noise_std=std, hidden_share=0.0) for std in (0.0, 1e-4)
    )
    blurred.load_state_dict(plain.state_dict())
    td = demonstrations(plain, 4)
    torch.testing.assert_close(blurred.imitation_loss(td), plain.imitation_loss(td))


@pytest.mark.slow
@pytest.mark.parametrize("what", ["log_prob", "entropy", "imitation"])
def test_gradients_agree_with_finite_differences(what: str) -> None:
    policy = tiny("token", layers=1).double()
    td = policy(demonstrations(policy, 2, dtype=torch.float64))

    def compute(module: TokenPolicy) -> torch.Tensor:
        if what == "imitation":
            torch.manual_seed(5)
            return module.imitation_loss(td)
        dist = module.get_dist(td)
        return dist.log_prob(td[SAMPLE]) if what == "log_prob" else dist.entropy()

    assert gradients_are_right(policy, compute)


def test_a_density_without_its_sample_or_of_another_is_refused() -> None:
    policy, td = tiny("token"), observations(2)
    with pytest.raises(DataError, match=r"the batch has no .*sample"):
        policy.get_dist(td)
    td = policy(td)
    with pytest.raises(DataError, match="another sample than the batch holds"):
        policy.get_dist(td).log_prob((td[SAMPLE] + 1) % 6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bins": 1}, "bins=1 must be at least 2"),
        ({"bin_range": 0.0}, "bin_range=0.0 must be positive"),
        ({"temperature": 0.0}, "temperature=0.0 must be positive"),
        ({"noise_std": -1.0}, "noise_std=-1.0 must not be negative"),
        ({"hidden_share": 1.5}, "hidden_share=1.5 must be within 0 and 1"),
        ({"hidden": ()}, "must name at least one layer"),
        ({"heads": 3}, "heads must divide width"),
        ({"log_prob_level": "tokens"}, "unknown log_prob_level 'tokens'"),
    ],
)
def test_wrong_options_are_refused(options: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        tiny("token", **options)
