"""OpenVLA in the collector, with its critic, and in the co-training loss."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss
from vla_cases import folder, rows

from rlco.collectors import RolloutCollector
from rlco.envs import make_env
from rlco.errors import DataError
from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.physics.tasks.make_task import make_task
from rlco.policies.vla.lora import add_lora
from rlco.policies.vla.openvla.load import load_openvla
from rlco.policies.vla.openvla.policy import OpenVLAPolicy
from rlco.policies.vla.prefix_critic import PrefixCritic, add_next_summaries


def actor(*, lora: bool = False) -> OpenVLAPolicy:
    torch.manual_seed(0)
    path = folder("openvla", action_size=7)
    model = load_openvla(path, dtype=torch.float32)
    if lora:
        add_lora(model, [model], rank=2)
    texts = make_task("push_cube").instructions
    return OpenVLAPolicy(model, instructions=texts, tokenizer=path)


def collect(policy: OpenVLAPolicy, critic: PrefixCritic) -> TensorDictBase:
    """Play three steps in two copies of a task."""
    env = make_env(
        "push_cube", num_envs=2, chunk=policy.chunk, horizon=3, image_size=(28, 28)
    )
    summaries = partial(add_next_summaries, summary=policy.new_summary)
    collector = RolloutCollector(env, policy, critic, prepare=summaries)
    rollout = collector.collect(0)
    collector.close()
    return rollout


@pytest.mark.slow
@pytest.mark.parametrize("lora", [False, True])
def test_it_is_collected_and_co_trained(lora: bool) -> None:
    policy = actor(lora=lora)
    critic = PrefixCritic(policy.model.hidden_size, hidden=(16,))
    rollout = collect(policy, critic)
    assert rollout["advantage"].shape == (2, 3, 1)
    flat = rollout.reshape(-1)
    flat["vla_action", "log_probs"] = log_probs(policy, flat)
    loss = CoTrainingLoss(
        ClipPPOLoss(policy, critic, functional=False, entropy_bonus=False),
        ImitationLoss(policy, functional=False),
        real_coeff=0.2,
    )
    real = rows(3, chunk=1)
    optimizer = torch.optim.Adam([p for p in loss.parameters() if p.requires_grad])
    before = {name: p.detach().clone() for name, p in loss.named_parameters()}

    def step() -> Any:
        out = loss(TensorDict({"sim": flat, "real": real}))
        optimizer.zero_grad()
        sum(v for k, v in out.items() if k.startswith("loss_")).backward()
        optimizer.step()
        return out

    out = step()
    assert float(out["max_ratio"]) == pytest.approx(1, abs=1e-5)
    moved = {n for n, p in loss.named_parameters() if not torch.equal(p, before[n])}
    actors = {name for name in moved if "actor_network" in name}
    assert actors
    assert moved - actors  # the critic
    assert all(".lora_" in name for name in actors) == lora
    # Both terms fall along their own gradient.
    again = step()
    assert float(again["loss_bc_real"]) < float(out["loss_bc_real"])
    assert float(again["loss_critic"]) < float(out["loss_critic"])


def test_next_summaries_are_those_of_the_next_observations() -> None:
    policy = actor()
    rollout = collect(policy, PrefixCritic(policy.model.hidden_size, hidden=(16,)))
    seen = rollout["next"].reshape(-1)
    expected = policy.new_summary(seen).view(2, 3, -1)
    found = rollout["next", "vla_prefix", "summary"]
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)


def test_a_missing_summary_is_named() -> None:
    with pytest.raises(DataError, match="prepare="):
        PrefixCritic(8, hidden=(4,))(rows(2))


@pytest.mark.slow
def test_what_next_observations_lack_is_said_before_their_values_are_taken() -> None:
    policy = actor()
    env = make_env(
        "push_cube", num_envs=2, chunk=policy.chunk, horizon=2, image_size=(28, 28)
    )
    critic = PrefixCritic(policy.model.hidden_size, hidden=(4,))
    collector = RolloutCollector(env, policy, critic)
    with pytest.raises(DataError, match=r"next observations.*add_next_summaries"):
        collector.collect(0)
    collector.close()
