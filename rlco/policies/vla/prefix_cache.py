"""What a vision-language model says of an observation, kept for the updates to come.

Of the work of one policy update of pi0.5 more than 99 % goes into images and text, the
prefix; the action expert only attends to its keys and values. As long as the prefix is
not trained they do not change: the rollout computes them, the batch carries them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from transformers import DynamicCache

from rlco.errors import DataError
from rlco.keys import IMAGE

PREFIX = "vla_prefix"
#: Where a batch holds prefixes.
PREFIX_KEYS = tuple((PREFIX, name) for name in ("keys", "values", "mask", "summary"))
#: One vector an observation, what critics read; float32 [*B, W].
SUMMARY = (PREFIX, "summary")


@dataclass(frozen=True)
class Prefix:
    """What the action expert attends to, and a summary of it.

    Attributes:
        keys: attention keys, shape (B, layers, key-value heads, P, head size).
        values: attention values, same shape.
        mask: which of the P positions are not padding, bool, shape (B, P).
        summary: mean of the last layer over those, float32, shape (B, W).
    """

    keys: torch.Tensor
    values: torch.Tensor
    mask: torch.Tensor
    summary: torch.Tensor

    @classmethod
    def of(
        cls, cache: DynamicCache, mask: torch.Tensor, hidden: torch.Tensor
    ) -> Prefix:
        """Stack a model's own cache.

        Args:
            cache: one entry a layer, each (B, key-value heads, P, head size).
            mask: bool, shape (B, P).
            hidden: the last layer's states, shape (B, P, W).
        """
        layers = [(layer.keys, layer.values) for layer in cache.layers]
        return cls(
            torch.stack([keys for keys, _ in layers], 1),
            torch.stack([values for _, values in layers], 1),
            mask,
            masked_mean(hidden, mask),
        )

    def cache(self) -> DynamicCache:
        """Return the keys and values as a cache of its own, free to be appended to."""
        # The cache's layers copy what they are given.
        return DynamicCache(
            tuple(zip(self.keys.unbind(1), self.values.unbind(1), strict=True))
        )

    @property
    def bytes_per_row(self) -> int:
        """Memory of one observation's keys and values [bytes]."""
        return 2 * self.keys[0].numel() * self.keys.element_size()

    def to(self, device: torch.device) -> Prefix:
        """Return the prefix on another device."""
        return Prefix(*(value.to(device) for value in vars(self).values()))

    def repeat(self, times: int) -> Prefix:
        """Return each row so many times, one after the other."""
        return Prefix(*(v.repeat_interleave(times, 0) for v in vars(self).values()))

    def write(self, tensordict: TensorDictBase) -> None:
        """Put the prefix into a batch, shape (B,)."""
        fields = {name: value.detach() for name, value in vars(self).items()}
        tensordict.set(PREFIX, TensorDict(fields, tensordict.batch_size))

    def write_summary(self, tensordict: TensorDictBase, device: torch.device) -> None:
        """Put into a batch what critics read alone; it holds no other prefix then."""
        cached = {"summary": self.summary.detach().to(device)}
        tensordict.set(PREFIX, TensorDict(cached, tensordict.batch_size))

    @staticmethod
    def read(tensordict: TensorDictBase) -> Prefix | None:
        """Return a batch's prefix, None where it holds none.

        Raises:
            DataError: parts of it are missing.
        """
        held = tensordict.get(PREFIX, None)
        names = set() if held is None else set(held.keys())
        if "keys" not in names:
            return None
        missing = sorted({"values", "mask", "summary"} - names)
        if missing:
            raise DataError(
                f"the batch's prefix lacks {', '.join(missing)}; keep all of "
                f"{PREFIX!r} of a rollout, or none of it."
            )
        return Prefix(*(held.get(name) for name in Prefix.__dataclass_fields__))


def with_prefixes(
    frames: TensorDictBase, prefix: Callable[[TensorDictBase], Prefix], *, rows: int
) -> ReplayBuffer:
    """Return demonstrated frames with their prefixes in place of their images.

    Args:
        frames: observations and chunks, shape (frames,).
        prefix: of a batch of observations, a policy's whose prefix is frozen.
        rows: how many frames pass through the model at once.
    """
    buffer = ReplayBuffer(storage=LazyTensorStorage(len(frames)))
    for part in frames.split(rows):
        kept = part.exclude(IMAGE)
        with torch.no_grad():
            prefix(part).write(kept)
        buffer.extend(kept)
    return buffer


def masked_mean(hidden: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return the mean (B, W), float32, of states (B, P, W) over unmasked positions.

    Example:
        >>> hidden = torch.tensor([[[1.0], [3.0], [99.0]]])
        >>> masked_mean(hidden, torch.tensor([[True, True, False]]))
        tensor([[2.]])
    """
    weight = mask.unsqueeze(-1).float()
    total: torch.Tensor = (hidden.float() * weight).sum(1)
    return total / weight.sum(1).clamp_min(1.0)
