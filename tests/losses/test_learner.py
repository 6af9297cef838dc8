"""Training on one rollout: what moves, what is told, what a checkpoint holds."""

from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from loss_cases import demonstrations, make_networks, observations
from tensordict import TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.objectives import ClipPPOLoss

from rlco.data import SimRealReplayBuffer
from rlco.losses import CoTrainingLoss, ImitationLoss, Learner

LOG_PROB = ("vla_action", "log_probs")


def make_learner(*, critic: bool = True, anchored: bool = True) -> Learner:
    """Return a learner of minibatches of 8 decisions and, anchored, 4 real rows."""
    torch.manual_seed(0)
    policy, value = make_networks()
    real = ReplayBuffer(storage=LazyTensorStorage(10))
    real.extend(demonstrations(10))
    ppo = ClipPPOLoss(
        policy,
        value if critic else None,
        entropy_bonus=False,
        critic_coeff=1.0 if critic else None,
    )
    return Learner(
        policy,
        value if critic else None,
        CoTrainingLoss(
            ppo,
            ImitationLoss(policy) if anchored else None,
            real_coeff=0.2 if anchored else 0.0,
        ),
        SimRealReplayBuffer(
            ReplayBuffer(storage=LazyTensorStorage(16)),
            real if anchored else None,
            sim_ratio=8 / 12 if anchored else 1.0,
            batch_size=12 if anchored else 8,
        ),
        torch.optim.Adam(policy.parameters(), 1e-2),
        torch.optim.Adam(value.parameters(), 1e-2) if critic else None,
        minibatch=8,
    )


def rollout(learner: Learner) -> TensorDictBase:
    with torch.no_grad():
        td = learner.policy(observations(16)).reshape(4, 4)
    td["advantage"] = torch.randn(4, 4, 1)
    if learner.critic is not None:
        td["value_target"], td["state_value"] = torch.randn(2, 4, 4, 1)
    return td


def weights(module: Any) -> torch.Tensor:
    return torch.cat([p.detach().flatten().clone() for p in module.parameters()])


def test_the_first_ratio_is_one_however_wrong_the_rollouts_log_probability() -> None:
    learner = make_learner()
    td = rollout(learner)
    td[LOG_PROB] += 0.25
    told = learner.update(td, epochs=2)
    assert told["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert told["log_prob_gap"] == pytest.approx(0.25, abs=1e-4)
    # Two epochs of two minibatches moved the policy away from it.
    assert told["max_ratio"] > 1.001
    assert {"grad_norm_ratio", "loss_bc_real", "loss_critic"} <= told.keys()


def test_the_critic_can_be_trained_alone() -> None:
    learner = make_learner()
    before = weights(learner.policy), weights(learner.critic)
    told = learner.update(rollout(learner), epochs=1, train_policy=False)
    assert torch.equal(weights(learner.policy), before[0])
    assert not torch.equal(weights(learner.critic), before[1])
    assert told["max_ratio"] == pytest.approx(1.0, abs=1e-5)


def test_without_critic_and_anchor_the_policy_alone_is_trained() -> None:
    learner = make_learner(critic=False, anchored=False)
    before = weights(learner.policy)
    told = learner.update(rollout(learner), epochs=1)
    assert not torch.equal(weights(learner.policy), before)
    assert not {"loss_critic", "loss_bc_real", "grad_cosine"} & told.keys()
    assert learner.state().keys() == {"policy", "actor_optimizer", "buffer"}


def test_a_learner_goes_on_from_its_state_as_if_never_stopped() -> None:
    learner = make_learner()
    first, second = rollout(learner), rollout(learner)
    learner.update(first, epochs=1)
    state = copy.deepcopy(learner.state())
    expected = learner.update(second, epochs=1)
    other = make_learner()
    for parameter in (*other.policy.parameters(), *other.critic.parameters()):
        parameter.data.zero_()
    other.load(state)
    assert other.update(second, epochs=1) == expected
    assert torch.equal(weights(other.policy), weights(learner.policy))
