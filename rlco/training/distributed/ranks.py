"""The processes that learn together, each with a copy of the policy: ranks.

Each plays other episodes and draws other real rows; gradients are averaged, and what is
decided by numbers of rollouts is decided by those of all ranks. The first rank writes
the run's folder. A process alone is one rank, for which nothing here does anything.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Protocol
from weakref import WeakSet

import numpy as np
import torch
import torch.distributed as dist
from tensordict import TensorDictBase
from torch import Tensor

from rlco.errors import LostProcessError
from rlco.runs.state_files import seed_everything

#: The first rank evaluates while the others wait for it.
PATIENCE = timedelta(hours=2)
#: What gloo and NCCL say of a rank that has ended.
_LOST = ("closed by peer", "reset by peer", "Broken pipe", "refused", "timed out")


@dataclass(frozen=True)
class Ranks:
    """Which of how many processes that learn together this one is.

    Every method is called by all ranks, in the same order.

    Attributes:
        rank: Counted from 0; the first writes the run's folder.
        count: How many there are.
        seed: Of the run; what a rank draws depends on it, on the rank and on the
            rollout.

    Example:
        >>> alone = Ranks()
        >>> alone.leads, alone.mean({"loss": 2.0}), alone.joined(torch.ones(3)).shape
        (True, {'loss': 2.0}, torch.Size([3]))
    """

    rank: int = 0
    count: int = 1
    seed: int = 0

    @property
    def leads(self) -> bool:
        """Whether this is the rank that writes."""
        return self.rank == 0

    @property
    def alone(self) -> bool:
        """Whether there are no others."""
        return self.count == 1

    def joined[T: (Tensor, TensorDictBase)](self, rows: T) -> T:
        """Return the rows of all ranks, in their order, along the first dimension.

        Args:
            rows: As many on each rank, none of them text.
        """
        if self.alone:
            return rows
        if isinstance(rows, Tensor):
            return self._gathered(rows)
        joined = rows.apply(self._gathered, batch_size=[])
        joined.batch_size = [self.count * len(rows), *rows.batch_size[1:]]
        return joined

    def own[T: (Tensor, TensorDictBase)](self, rows: T) -> T:
        """Return this rank's part of rows that `joined` returned."""
        if self.alone:
            return rows
        size = len(rows) // self.count
        return rows[self.rank * size : (self.rank + 1) * size]

    def mean(self, numbers: Mapping[str, float]) -> dict[str, float]:
        """Return the mean of each number over the ranks, which have the same names."""
        return self._reduced(numbers, dist.ReduceOp.SUM, 1 / self.count)

    def largest(self, numbers: Mapping[str, float]) -> dict[str, float]:
        """Return the largest of each number over the ranks."""
        return self._reduced(numbers, dist.ReduceOp.MAX, 1.0)

    def total(self, numbers: Tensor) -> Tensor:
        """Return the sum of a tensor over the ranks."""
        if self.alone:
            return numbers
        numbers = numbers.clone()
        dist.all_reduce(numbers)
        return numbers

    def from_lead(self, value: Any) -> Any:
        """Return what the first rank gives; what the others give is not read."""
        if self.alone:
            return value
        sent = [value]
        # Sent from one process of a run to another: no file is unpickled.
        dist.broadcast_object_list(sent, src=0)
        return sent[0]

    def own_seed(self, rollout: int) -> int | None:
        """Return a seed of this rank for one rollout; None on the first.

        The first goes on from the random state that its checkpoints hold. The others
        need none of theirs: a resumed run draws what an uninterrupted one does.
        """
        if self.leads:
            return None
        mixed = np.random.SeedSequence([self.seed, self.rank, rollout])
        return int(mixed.generate_state(1)[0])

    def draw_own(self, rollout: int) -> None:
        """Let what is random from now on be this rank's own."""
        if (seed := self.own_seed(rollout)) is not None:
            seed_everything(seed)

    def _gathered(self, rows: Tensor) -> Tensor:
        # gloo sends no flags.
        plain = rows.to(torch.uint8) if rows.dtype == torch.bool else rows
        parts = [torch.empty_like(plain) for _ in range(self.count)]
        dist.all_gather(parts, plain.contiguous())
        return torch.cat(parts).to(rows.dtype)

    def _reduced(
        self, numbers: Mapping[str, float], operation: Any, scale: float
    ) -> dict[str, float]:
        if self.alone or not numbers:
            return dict(numbers)
        values = torch.tensor(list(numbers.values()), dtype=torch.float64)
        dist.all_reduce(values, op=operation)
        return dict(zip(numbers, (values * scale).tolist(), strict=True))


def join_ranks(seed: int, *, gpus: bool = False) -> Ranks:
    """Connect the processes that torchrun has started, over gloo.

    Args:
        seed: Of the run.
        gpus: Whether the policy computes on one. What lies there then goes over NCCL,
            if each process has one of its own.
    """
    backend = "cpu:gloo,cuda:nccl" if gpus and gpus_for_all() else "gloo"
    dist.init_process_group(backend, timeout=PATIENCE)
    return Ranks(dist.get_rank(), dist.get_world_size(), seed)


def local_rank() -> int:
    """Return which of this machine's processes this one is, counted from 0."""
    return int(os.environ.get("LOCAL_RANK", "0"))


def gpus_for_all() -> bool:
    """Return whether this machine has a GPU for each process that torchrun started."""
    here = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    return torch.cuda.is_available() and torch.cuda.device_count() >= here


class Connected(Protocol):
    """What talks to other ranks by itself."""

    def close(self) -> None:
        """Let go of the connection."""


#: What has to let go before the connection ends.
connected: WeakSet[Connected] = WeakSet()


def leave_ranks() -> None:
    """Disconnect; the counterpart of `join_ranks`."""
    # Freed after the process group, PyTorch's DistributedDataParallel ends it while it
    # holds Python's lock, which a thread of the group may wait for: both for ever.
    for one in list(connected):
        one.close()
    gc.collect()
    if dist.is_initialized():
        dist.destroy_process_group()


def lost_rank(error: BaseException | None) -> LostProcessError | None:
    """Return an error that says that another rank has ended; None if none has.

    Example:
        >>> print(lost_rank(RuntimeError("[gloo] Connection closed by peer [::1]")))
        another process of this training has ended, whose message or signal torchrun \
reports; nothing that was saved is lost: start it again with resume=DIR.
        >>> lost_rank(RuntimeError("shapes do not match")) is None
        True
    """
    if not any(words in str(error) for words in _LOST):
        return None
    return LostProcessError(
        "another process of this training has ended, whose message or signal torchrun "
        "reports; nothing that was saved is lost: start it again with resume=DIR."
    )
