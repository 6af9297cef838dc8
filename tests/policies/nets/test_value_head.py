"""Critics: on the token policy's own state, and what either kind may read beside."""

from __future__ import annotations

import pytest
import torch
from policy_cases import observations, tiny
from torchrl.objectives import ClipPPOLoss

from rlco.errors import ConfigError, DataError
from rlco.policies import ValueHead, ValueNetwork


@pytest.mark.parametrize("detach", [True, False])
def test_its_gradient_reaches_the_policy_only_where_asked(detach: bool) -> None:
    torch.manual_seed(0)
    policy = tiny("token")
    value = ValueHead(policy, hidden=(4,), detach=detach)
    value(observations(5))["state_value"].sum().backward()
    assert all(p.grad is not None for p in value.own_parameters())
    reached = [p.grad is not None for p in policy.observe.parameters()]
    assert all(reached) is not detach
    assert any(reached) is not detach


def test_it_reads_the_observation_and_no_token() -> None:
    torch.manual_seed(0)
    policy = tiny("token")
    value, td = ValueHead(policy, hidden=(4,)), observations(5)
    before = value(td.clone())["state_value"]
    after = value(policy(td.clone()))["state_value"]
    assert torch.equal(before, after)
    td["observation", "state"] += 1.0
    assert not torch.allclose(value(td)["state_value"], before)


def test_ppo_trains_the_head_and_leaves_the_policys_share_to_the_policy() -> None:
    torch.manual_seed(0)
    policy = tiny("token")
    value = ValueHead(policy, hidden=(4,))
    loss = ClipPPOLoss(policy, value, entropy_bonus=False)
    td = value(policy(observations(6)))
    td["advantage"], td["value_target"] = torch.randn(6, 1), torch.randn(6, 1)
    td = td.detach()
    out = loss(td)
    assert out["max_ratio"].item() == pytest.approx(1.0, abs=1e-5)
    (critic,) = torch.autograd.grad(
        out["loss_critic"], [policy.network.place], allow_unused=True, retain_graph=True
    )
    assert critic is None
    (actor,) = torch.autograd.grad(out["loss_objective"], [policy.network.place])
    assert actor.abs().sum() > 0


def critic(kind: str) -> ValueHead | ValueNetwork:
    if kind == "head":
        return ValueHead(tiny("token"), hidden=(4,), time_left=True)
    return ValueNetwork(3, num_instructions=2, hidden=(4,), time_left=True)


@pytest.mark.parametrize("kind", ["head", "network"])
def test_a_critic_may_read_how_long_an_episode_goes_on(kind: str) -> None:
    torch.manual_seed(0)
    value, td = critic(kind), observations(5)
    with pytest.raises(DataError, match=r"no .*'time_left'"):
        value(td.clone())
    td["observation", "time_left"] = torch.full((5, 1), 0.5)
    early = value(td.clone())["state_value"]
    td["observation", "time_left"] = torch.zeros(5, 1)
    late = value(td.clone())["state_value"]
    # Half of an episode is 1 on the network's scale, from -1 at its end to 1.
    network = value.head if kind == "head" else value.network
    assert not torch.allclose(early, late)
    weight = next(network.parameters())
    with torch.no_grad():
        weight[:, -1] = 0
    assert torch.equal(
        value(td.clone())["state_value"],
        value(td.set(("observation", "time_left"), torch.ones(5, 1)))["state_value"],
    )


def test_another_kind_has_no_such_state() -> None:
    with pytest.raises(ConfigError, match="GaussianPolicy has no state that a value"):
        ValueHead(tiny("gaussian"))
