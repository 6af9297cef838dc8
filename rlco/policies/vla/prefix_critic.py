"""A critic on what the vision-language model says of an observation."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from rlco.errors import DataError
from rlco.keys import STATE_VALUE
from rlco.policies.nets.mlp import Mlp
from rlco.policies.vla.prefix_cache import SUMMARY


class PrefixCritic(TensorDictModuleBase):
    """Expected return, from the summary that the policy writes beside its sample.

    It costs no pass of its own through the model, and its gradient never moves the
    policy: the summary is stored, not computed anew.

    Args:
        summary_size: dimension W of a summary.
        hidden: width of each hidden layer.

    Example:
        >>> from tensordict import TensorDict
        >>> critic = PrefixCritic(8, hidden=(16,))
        >>> td = TensorDict({"vla_prefix": {"summary": torch.randn(5, 8)}}, [5])
        >>> critic(td)["state_value"].shape
        torch.Size([5, 1])
    """

    def __init__(
        self, summary_size: int, *, hidden: Sequence[int] = (512, 256, 128)
    ) -> None:
        super().__init__()
        # Language models' states are far from unit size.
        self.norm = torch.nn.LayerNorm(summary_size)
        self.network = Mlp(summary_size, 1, hidden=hidden, gain=0.02)
        self.in_keys = [SUMMARY]
        self.out_keys = [STATE_VALUE]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``state_value`` [*B, 1] into ``tensordict``.

        Raises:
            DataError: there is no summary.
        """
        summary = tensordict.get(SUMMARY, None)
        if summary is None:
            raise DataError(
                f"the batch has no {SUMMARY!r}, which this critic reads; policies "
                "write it beside their sample, and add_next_summaries adds it to a "
                "rollout's next observations (RolloutCollector's prepare=)."
            )
        value = self.network(self.norm(summary.to(self.norm.weight)))
        tensordict.set(STATE_VALUE, value.to(summary.device))
        return tensordict


def add_next_summaries(
    rollout: TensorDictBase, summary: Callable[[TensorDictBase], torch.Tensor]
) -> None:
    """Give the next observations of a rollout [N, T] their summaries too.

    The next observation of a decision is the observation of the one after it, which
    the policy has encoded already; that of the last one passes through the model.

    Args:
        rollout: whole episodes, one a row, summaries beside the observations.
        summary: of a batch of observations, the policy's ``new_summary``.
    """
    final = summary(rollout["next"][:, -1]).to(rollout[SUMMARY].device)
    following = torch.cat([rollout[SUMMARY][:, 1:], final.unsqueeze(1)], 1)
    rollout.set(("next", *SUMMARY), following)
