"""Learners of small networks, and rollouts for them to learn from."""

from __future__ import annotations

from typing import Any

import torch
from loss_cases import demonstrations, make_networks, observations
from tensordict import TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.objectives import ClipPPOLoss

from rlco.data import SimRealReplayBuffer
from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.training import Learner


def make_learner(
    *,
    critic: bool = True,
    anchored: bool = True,
    functional: bool = True,
    policy: Any = None,
    **options: Any,
) -> Learner:
    """Return a learner of minibatches of 8 decisions and, anchored, 4 real rows.

    Its policy is a Gaussian where none of the same sizes is given.
    """
    torch.manual_seed(0)
    gaussian, value = make_networks()
    policy = gaussian if policy is None else policy
    real = ReplayBuffer(storage=LazyTensorStorage(10))
    real.extend(demonstrations(10))
    ppo = ClipPPOLoss(
        policy,
        value if critic else None,
        entropy_bonus=False,
        critic_coeff=1.0 if critic else None,
        functional=functional,
    )
    return Learner(
        policy,
        value if critic else None,
        CoTrainingLoss(
            ppo,
            ImitationLoss(policy, functional=functional) if anchored else None,
            real_coeff=0.2 if anchored else 0.0,
        ),
        SimRealReplayBuffer(
            ReplayBuffer(storage=LazyTensorStorage(48)),
            real if anchored else None,
            sim_ratio=8 / 12 if anchored else 1.0,
            batch_size=12 if anchored else 8,
        ),
        torch.optim.Adam(policy.parameters(), 1e-2),
        torch.optim.Adam(value.parameters(), 1e-2) if critic else None,
        minibatch=8,
        **options,
    )


def rollout(learner: Learner) -> TensorDictBase:
    with torch.no_grad():
        td = learner.policy(observations(16)).reshape(4, 4)
    td["advantage"] = torch.randn(4, 4, 1)
    if learner.critic is not None:
        td["value_target"], td["state_value"] = torch.randn(2, 4, 4, 1)
    return td
