"""The Gaussian chunk policy: densities, units, gradients, precision."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.errors import ConfigError, DataError
from rlco.policies import Actor, GaussianPolicy, ValueNetwork


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


def make_policy(**options: Any) -> GaussianPolicy:
    """Return a policy on 2 states, 3 object numbers, 2 instructions; H = 2, A = 2."""
    policy = GaussianPolicy(
        2,
        chunk=2,
        action_size=2,
        environment_state_size=3,
        num_instructions=2,
        hidden=(8,),
        activation="tanh",
        **options,
    )
    policy.network.head.weight.data.normal_(0, 0.3)
    return policy


def observations(*batch: int) -> TensorDictBase:
    content = {
        "observation": {
            "state": torch.randn(*batch, 2),
            "environment_state": torch.randn(*batch, 3),
        },
        "instruction_id": torch.randint(2, batch),
    }
    return TensorDict(content, batch)


def test_log_prob_and_entropy_sum_over_the_chunk() -> None:
    # Each number adds -z^2/2 - log(std) - log(2 pi)/2 with z = (x - mean)/std, and
    # 1/2 + log(2 pi)/2 + log(std) to the entropy; std .1 and .5, two steps of each.
    policy, td = make_policy(std=[0.1, 0.5]), observations(5)
    dist = policy.get_dist(td)
    std = torch.tensor([0.1, 0.5])
    z = torch.tensor([[1.0, -2.0], [0.5, 0.0]])
    logs = 2 * (math.log(0.1) + math.log(0.5))
    expected = -(1 + 4 + 0.25) / 2 - logs - 4 * math.log(2 * math.pi) / 2
    found = dist.log_prob(dist.mean + z * std)
    torch.testing.assert_close(found, torch.full((5,), expected))
    entropy = 4 * (0.5 + math.log(2 * math.pi) / 2) + logs
    torch.testing.assert_close(dist.entropy(), torch.full((5,), entropy))


def test_forward_writes_a_sample_its_density_and_the_raw_action() -> None:
    policy = make_policy()
    policy.set_normalization(action=([-0.5, 0.0], [0.5, 1.0]))
    td = policy(observations(4, 3))
    sample = td["vla_action", "sample"]
    assert sample.shape == (4, 3, 2, 2)
    assert td["vla_action", "log_probs"].shape == (4, 3)
    # raw = low + (n + 1) (high - low) / 2: halves n; the second number is shifted.
    raw = sample / 2 + torch.tensor([0.0, 0.5])
    torch.testing.assert_close(td["action"], raw.clamp(-1, 1))
    torch.testing.assert_close(td["vla_action", "chunk"], td["action"])
    torch.testing.assert_close(
        policy.get_dist(td).log_prob(sample), td["vla_action", "log_probs"]
    )
    assert set(policy.out_keys) <= set(td.keys(True, True))
    assert isinstance(policy, Actor)


def test_only_raw_actions_are_clipped() -> None:
    policy = make_policy()
    policy.network.head.bias.data.fill_(3.0)
    policy.network.head.weight.data.zero_()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = policy(observations(2))
    torch.testing.assert_close(td["vla_action", "sample"], torch.full((2, 2, 2), 3.0))
    assert bool((td["action"] == 1).all())


@pytest.mark.parametrize(
    "kind", [ExplorationType.MODE, ExplorationType.MEAN, ExplorationType.DETERMINISTIC]
)
def test_without_exploration_it_acts_by_its_mean(kind: ExplorationType) -> None:
    policy, td = make_policy(), observations(3)
    with set_exploration_type(kind):
        td = policy(td)
    assert torch.equal(td["vla_action", "sample"], policy.get_dist(td).mean)


def test_with_exploration_the_sample_has_the_right_moments() -> None:
    policy, td = make_policy(std=[0.1, 0.4]), observations(1).expand(20_000)
    with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
        sample = policy(td.clone())["vla_action", "sample"]
        mean = policy.get_dist(td).mean
    # Standard errors: .4 / sqrt(20000) = .003 of the mean, .002 of the std.
    torch.testing.assert_close(sample.mean(0), mean[0], atol=0.012, rtol=0)
    expected = torch.tensor([0.1, 0.4]).expand(2, 2)
    torch.testing.assert_close(sample.std(0), expected, atol=0.01, rtol=0)


@pytest.mark.parametrize(
    ("imitation", "expected"),
    [
        # Mean 0, targets (.4, .2): (.16 + .04) / 2, over the action numbers.
        ("mse", 0.1),
        # sum of t^2 / (2 std^2) + log(std) + log(2 pi)/2 = 2.5 + 2 (-.690499)
        ("nll", 1.119002),
    ],
)
def test_imitation_loss_by_hand(imitation: Any, expected: float) -> None:
    policy = make_policy(imitation=imitation)
    policy.network.head.weight.data.zero_()
    policy.set_normalization(action=([-0.5, -0.5], [0.5, 0.5]))
    td = observations(3, 2)
    # Raw (.2, .1) is (.4, .2) normalised.
    td["vla_action", "chunk"] = torch.tensor([0.2, 0.1]).expand(3, 2, 2, 2)
    found = policy.imitation_loss(td)
    torch.testing.assert_close(found, torch.full((3, 2, 2), expected))


@pytest.mark.slow
@pytest.mark.parametrize("what", ["mse", "nll", "log_prob"])
def test_gradients_agree_with_finite_differences(what: str) -> None:
    imitation: Any = "mse" if what == "mse" else "nll"
    policy = make_policy(imitation=imitation, learn_std=True).double()
    td = observations(3).double()
    td["instruction_id"] = td["instruction_id"].long()
    td["vla_action", "chunk"] = torch.rand(3, 2, 2, dtype=torch.float64)
    sample = torch.randn(3, 2, 2, dtype=torch.float64)
    names = [name for name, _ in policy.named_parameters()]
    assert "std.log_std" in names

    def function(*values: torch.Tensor) -> torch.Tensor:
        network = copy.deepcopy(policy)
        parameters = dict(zip(names, values, strict=True))

        def call(module: GaussianPolicy) -> torch.Tensor:
            if what == "log_prob":
                return module.get_dist(td).log_prob(sample)
            return module.imitation_loss(td)

        class Called(torch.nn.Module):
            def __init__(self) -> None:
                super().__init__()
                self.policy = network

            def forward(self) -> torch.Tensor:
                return call(self.policy)

        renamed = {f"policy.{name}": value for name, value in parameters.items()}
        return torch.func.functional_call(Called(), renamed, ())

    values = [p.detach().clone().requires_grad_() for p in policy.parameters()]
    assert torch.autograd.gradcheck(function, values)


@pytest.mark.parametrize("name", ["state", "environment_state"])
def test_every_observation_reaches_the_mean(name: str) -> None:
    policy, td = make_policy(), observations(1)
    before = policy.get_dist(td).mean
    td["observation", name] = td["observation", name] + 1.0
    assert not torch.allclose(policy.get_dist(td).mean, before)


def test_the_instruction_reaches_the_mean() -> None:
    policy, td = make_policy(), observations(1)
    td["instruction_id"] = torch.tensor([0])
    first = policy.get_dist(td).mean
    td["instruction_id"] = torch.tensor([1])
    assert not torch.allclose(policy.get_dist(td).mean, first)


def test_a_standard_deviation_is_learned_only_where_asked_and_stays_in_bounds() -> None:
    assert "std.log_std" not in dict(make_policy().named_parameters())
    policy = make_policy(learn_std=True)
    policy.std.log_std.data = torch.tensor([-50.0, 50.0])
    torch.testing.assert_close(policy.std(), torch.tensor([0.01, 1.0]))


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_other_precisions_stay_close_to_float32(dtype: torch.dtype) -> None:
    policy, td = make_policy(layer_norm=True), observations(16)
    reference = policy.get_dist(td).mean
    dist = policy.to(dtype).get_dist(td)
    assert dist.mean.dtype == torch.promote_types(dtype, torch.float32)
    tolerance = 0.05 if dtype == torch.bfloat16 else 1e-6
    torch.testing.assert_close(
        dist.mean.float(), reference, atol=tolerance, rtol=tolerance
    )


@pytest.mark.slow
def test_get_dist_and_forward_compile_as_one_graph() -> None:
    policy, td = make_policy(), observations(4)
    torch.compiler.reset()
    compiled = torch.compile(policy, fullgraph=True, backend="eager")
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = policy(td.clone())
        found = compiled(td.clone())
    torch.testing.assert_close(found["action"], expected["action"])


def test_wrong_shapes_are_refused() -> None:
    policy, td = make_policy(), observations(3)
    td["vla_action", "chunk"] = torch.zeros(3, 1, 2)
    with pytest.raises(DataError, match=r"shape \(3, 1, 2\), the policy's \(3, 2, 2\)"):
        policy.imitation_loss(td)
    td["observation", "state"] = torch.zeros(3, 1)
    with pytest.raises(DataError, match="state has 1 number, the policy was built for"):
        policy.get_dist(td)
    with pytest.raises(DataError, match=r"no \('observation', 'environment_state'\)"):
        policy.get_dist(
            td.exclude(("observation", "environment_state")).update(
                {"observation": {"state": torch.zeros(3, 2)}}
            )
        )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"chunk": 0}, "must be at least 1"),
        ({"std": 0.0}, "must be one positive number"),
        ({"std": [0.2]}, "or 7 of them"),
        ({"imitation": "l1"}, "unknown imitation 'l1'"),
        ({"activation": "relu"}, "unknown activation 'relu'; known: silu, tanh"),
        ({"hidden": (0,)}, "must be positive"),
        ({"state_size": 0}, "one must be positive"),
    ],
)
def test_wrong_options_are_refused(options: Any, message: str) -> None:
    arguments = {"state_size": 3, "chunk": 4, **options}
    with pytest.raises(ConfigError, match=message):
        GaussianPolicy(**arguments)


def test_value_network_reads_the_same_and_gives_one_number_a_decision() -> None:
    value = ValueNetwork(2, environment_state_size=3, num_instructions=2, hidden=(8,))
    td = observations(4, 3)
    out = value(td.clone())["state_value"]
    assert out.shape == (4, 3, 1)
    td["observation", "environment_state"] += 1.0
    assert not torch.allclose(value(td)["state_value"], out)
    # Scaled observations and quantiles scaled alike are the same to it.
    value.set_normalization(state=([-2.0, -2.0], [2.0, 2.0]))
    doubled = td.clone()
    expected = value(td)["state_value"]
    doubled["observation", "state"] *= 2
    value.set_normalization(state=([-4.0, -4.0], [4.0, 4.0]))
    torch.testing.assert_close(value(doubled)["state_value"], expected)
