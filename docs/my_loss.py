"""A loss of one's own: Huber's, which bad demonstrations pull at less than others."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictParams, dispatch
from torch.nn import functional
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import LossModule


class HuberLoss(LossModule):
    """Huber's loss between the most likely chunk and the demonstrated one."""

    # Named here, or TorchRL warns that it makes them itself.
    actor_network: Any
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init__(self, actor: Any, delta: float = 0.1) -> None:
        super().__init__()
        self.convert_to_functional(actor, "actor_network")
        self.in_keys = [*actor.in_keys, ("vla_action", "chunk"), "action_is_pad"]
        self.out_keys = ["loss_huber"]
        self.delta = delta

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the mean over the steps that are not padding."""
        seen = tensordict.select(*self.actor_network.in_keys)
        with (
            self.actor_network_params.to_module(self.actor_network),
            set_exploration_type(ExplorationType.DETERMINISTIC),
        ):
            acted = self.actor_network(seen)["vla_action", "chunk"]
        wanted = tensordict["vla_action", "chunk"]
        each = functional.huber_loss(acted, wanted, reduction="none", delta=self.delta)
        there = ~tensordict["action_is_pad"]
        return TensorDict({"loss_huber": torch.mean(each[there])})
