"""How much of what a policy learned in one domain holds for demonstrations of another.

Nothing here needs a simulator or a robot: two sets of demonstrations are enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from rlco import keys
from rlco.training.imitation_errors import likely_chunks

ROWS = 1024  # frames that are computed at once
#: Weight of the probe's penalty, beside features of variance 1.
RIDGE = 1e-2


class Explained(NamedTuple):
    """Sums over demonstrated action numbers, in units of the normalised action.

    Attributes:
        error: Squared distances of the policy's most likely actions, shape (A,).
        total: Squared distances of the demonstrations' own mean, shape (A,).
    """

    error: Tensor
    total: Tensor

    @property
    def share(self) -> float:
        """Share of the demonstrated actions' variance that the policy explains.

        1: it does what was demonstrated; 0: no better than always doing the mean of
        these demonstrations; below 0: worse than that. An action number counts as
        much as it varies.

        Example:
            >>> Explained(torch.tensor([1.0, 0.0]), torch.tensor([3.0, 1.0])).share
            0.75
        """
        return 1.0 - float(self.error.sum() / self.total.sum())

    def shares(self) -> list[float | None]:
        """Return the share of each action number; None where none was moved."""
        return [
            1.0 - error / total if total > 0 else None
            for error, total in zip(
                self.error.tolist(), self.total.tolist(), strict=True
            )
        ]


def explained(policy: Any, frames: TensorDictBase) -> Explained:
    """Return how much of demonstrated actions a policy explains.

    Args:
        policy: A policy of this package.
        frames: Every frame of the demonstrations, of ``DemoReplayBuffer.frames()``.
    """
    likely = likely_chunks(policy, frames)
    with torch.no_grad():
        normalized = policy.action_normalizer
        real = ~frames[keys.IS_PAD]
        demonstrated = normalized(frames[keys.CHUNK])[real]
        error = (normalized(likely)[real] - demonstrated).square().sum(0)
        # What was held still varies by rounding alone.
        varies = frames[keys.CHUNK][real].amax(0) > frames[keys.CHUNK][real].amin(0)
        total = (demonstrated - demonstrated.mean(0)).square().sum(0)
    return Explained(error * varies, total * varies)


def pooled(parts: Sequence[Explained]) -> Explained:
    """Return what several policies explain of their own held-out parts, together."""
    return Explained(
        torch.stack([part.error for part in parts]).sum(0),
        torch.stack([part.total for part in parts]).sum(0),
    )


def features(policy: Any, frames: TensorDictBase) -> Tensor:
    """Return what a Gaussian policy computes just before its actions, (frames, F)."""
    found: list[Tensor] = []
    hook = policy.network.head.register_forward_hook(
        lambda module, given, out: found.append(given[0])
    )
    try:
        with torch.no_grad():
            for part in frames.select(*policy.in_keys).split(ROWS):
                policy.network(policy.features(part))
    finally:
        hook.remove()
    return torch.cat(found)


def probe_accuracy(
    train: tuple[Tensor, Tensor], held_out: tuple[Tensor, Tensor]
) -> float:
    """Return how often a linear probe tells two domains apart, by their features.

    A ridge regression on +1 and -1, in which both domains count as much; so does each
    in the accuracy. 0.5 is chance.

    Args:
        train: Features of frames of the one domain and of the other, (n, F) each.
        held_out: The same, of episodes that are not in ``train``.

    Example:
        >>> one, other = torch.zeros(4, 1), torch.ones(6, 1)
        >>> probe_accuracy((one, other), (one, other))
        1.0
        >>> probe_accuracy((one, one), (one, one))
        0.5
    """
    mean = torch.stack([part.double().mean(0) for part in train]).mean(0)
    spread = torch.cat([part.double() - mean for part in train]).std(0)
    scale = torch.where(spread > 0, spread, 1.0)

    def prepared(part: Tensor) -> Tensor:
        scaled = (part.double() - mean) / scale
        return torch.cat([scaled, torch.ones(len(part), 1).double()], 1)

    rows = [prepared(part) / len(part) ** 0.5 for part in train]
    target = [
        torch.full((len(part),), sign / len(part) ** 0.5).double()
        for part, sign in zip(train, (1.0, -1.0), strict=True)
    ]
    x, y = torch.cat(rows), torch.cat(target)
    penalty = RIDGE * torch.eye(x.shape[1]).double()
    weight = torch.linalg.solve(x.T @ x + penalty, x.T @ y)
    one, other = ((prepared(part) @ weight) for part in held_out)
    right = [(one > 0).double().mean(), (other <= 0).double().mean()]
    return float(sum(right) / 2)
