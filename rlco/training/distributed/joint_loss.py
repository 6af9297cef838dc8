"""A co-training loss whose gradient is that of the rows of all ranks together."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torchrl.objectives import LossModule

from rlco.errors import ConfigError
from rlco.keys import SIM
from rlco.losses.co_training import CoTrainingLoss
from rlco.training.distributed.ranks import Ranks, connected

#: A loss names the mask of the steps that it leaves out by one of these.
_MASKS = ("is_pad", "pad_mask")


class JointLoss:
    """Returns what a `CoTrainingLoss` does, with the gradient of all ranks' rows.

    PyTorch's DistributedDataParallel averages gradients over ranks; an average of means
    over different numbers of rows is no mean. So each root's terms count by its share
    of the rows, or of the steps that are not padded, that all ranks have of that root.
    What is reported counts likewise: `Ranks.mean` of it is the mean over all rows.

    Args:
        loss: Of losses with ``functional=False``: their networks must be submodules.
        ranks: Each calls the loss as often as the others, with rows of its own.

    Raises:
        ConfigError: The loss is functional.
    """

    def __init__(self, loss: CoTrainingLoss, ranks: Ranks) -> None:
        if any(one.functional for one in (loss.sim_loss, loss.real_loss) if one):
            raise ConfigError(
                [
                    "several ranks cannot train a functional loss, whose parameters "
                    "DistributedDataParallel does not see; build both losses with "
                    "functional=False"
                ]
            )
        # Whoever called its module would get gradients of this rank alone, unnoticed.
        self._parallel: nn.Module | None = DistributedDataParallel(
            _Shared(loss, ranks), broadcast_buffers=False, find_unused_parameters=True
        )
        connected.add(self)

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the terms and what is reported; ``backward`` averages over ranks."""
        if self._parallel is None:
            raise RuntimeError("the ranks of this loss have left each other")
        out: TensorDictBase = self._parallel(batch)[0]
        return out

    def close(self) -> None:
        """Let go of the other ranks; `leave_ranks` calls it."""
        self._parallel = None


class _Shared(nn.Module):
    """What DistributedDataParallel wraps."""

    def __init__(self, loss: CoTrainingLoss, ranks: Ranks) -> None:
        super().__init__()
        self.loss = loss
        self._ranks = ranks

    def forward(self, batch: TensorDictBase) -> tuple[TensorDictBase, tuple[Any, ...]]:
        """Return the output, and its leaves: DDP looks for used weights from these."""
        terms = self.loss.terms(batch)
        shares = self._shares(batch)
        out = {
            name: value * shares[root]
            for root, named in terms.items()
            for name, value in named.items()
        }
        return TensorDict(out), tuple(out.values())

    def _shares(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Return this rank's rows over the mean number of a rank's, for each root."""
        roots = self.loss.roots
        losses = {
            root: self.loss.sim_loss if root == SIM else self.loss.real_loss
            for root in roots
        }
        counts = torch.tensor(
            [
                counted(losses[root], batch.get(getattr(self.loss.tensor_keys, root)))
                for root in roots
            ],
            dtype=torch.float64,
        )
        totals = self._ranks.total(counts)
        # Of padding alone there is no mean; its terms are 0.
        shares = self._ranks.count * counts / totals.clamp(min=1)
        summed = [getattr(losses[root], "reduction", "mean") == "sum" for root in roots]
        shares[torch.tensor(summed)] = self._ranks.count
        return {root: share.float() for root, share in zip(roots, shares, strict=True)}


def counted(loss: LossModule, data: TensorDictBase) -> int:
    """Return how many numbers a loss's mean is over, up to a constant factor.

    Args:
        loss: Padded steps are left out where it reads ``is_pad`` or ``pad_mask``.
        data: What it is given, batch size [B].

    Example:
        >>> from rlco.losses import ImitationLoss
        >>> from rlco.policies import GaussianPolicy
        >>> loss = ImitationLoss(GaussianPolicy(3, chunk=2), functional=False)
        >>> pad = torch.tensor([[False, False], [False, True]])
        >>> counted(loss, TensorDict({"action_is_pad": pad}, [2]))
        3
    """
    for name in _MASKS:
        key = getattr(loss.tensor_keys, name, None)
        mask: Tensor | None = None if key is None else data.get(key, None)
        if mask is not None:
            return int((~mask).sum())
    return int(data.numel())
