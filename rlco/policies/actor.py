"""What every kind of policy offers, so that losses and recipes need not ask which."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from tensordict import TensorDictBase


@runtime_checkable
class Actor(Protocol):
    """A policy that acts in chunks, explores, and can be compared with demonstrations.

    Axes: ``B`` stands for any batch shape, ``H`` for the steps of a chunk, ``A`` for
    the action dimensions.

    Attributes:
        kind: the name under which :func:`rlco.policies.make_policy` builds it.
        arguments: its constructor's arguments, in types that JSON holds.
        in_keys: the entries that it reads.
        out_keys: the entries that ``forward`` writes.
        dist_sample_keys: the entry that ``get_dist(td).log_prob`` takes; TorchRL's
            PPO losses read this name and set their ``action`` key to it.
        log_prob_keys: the entry that holds the sample's log-probability; TorchRL's
            PPO losses set their ``sample_log_prob`` key to it.
        replay_keys: the entries of a rollout that ``get_dist`` reads: what it takes
            to compute the log-probability again.
    """

    kind: ClassVar[str]
    arguments: dict[str, Any]
    in_keys: list[Any]
    out_keys: list[Any]
    dist_sample_keys: list[Any]
    log_prob_keys: list[Any]
    replay_keys: list[Any]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the sample, its log-probability [B] and the raw actions [B, H, A]."""

    def get_dist(self, tensordict: TensorDictBase) -> torch.distributions.Distribution:
        """Return the distribution whose ``log_prob(sample)`` and ``entropy()`` are [B].

        Each covers one whole decision, in the normalised action space; how its parts
        are summed up is the policy's option. Where the parts of a sample depend on
        each other the batch must hold the sample, and the density is that sample's.
        """

    def imitation_loss(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return the distance to ``("vla_action", "chunk")``, a step each [B, H]."""
