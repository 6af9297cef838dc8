"""The density of a sample that was made step by step, along that sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Literal, get_args

import torch
from tensordict import TensorDictBase
from torch.distributions import Distribution

from rlco.errors import ConfigError, DataError
from rlco.keys import SAMPLE

#: What one log-probability covers: the whole decision, a control step, a number.
LogProbLevel = Literal["chunk", "action", "token"]


def per_level(elements: torch.Tensor, level: LogProbLevel) -> torch.Tensor:
    """Sum what each number contributes [*B, H, A] up to a level.

    Returns:
        [*B] for "chunk", [*B, H] for "action", [*B, H, A] for "token". TorchRL's PPO
        losses make one ratio of each and give all of a decision its one advantage.

    Example:
        >>> per_level(torch.ones(5, 4, 7), "action")[0]
        tensor([7., 7., 7., 7.])
    """
    if level == "chunk":
        return elements.sum((-2, -1))
    return elements.sum(-1) if level == "action" else elements


def check_level(level: str) -> list[str]:
    """Return what is wrong with the name of a level."""
    known = get_args(LogProbLevel)
    if level in known:
        return []
    return [f"unknown log_prob_level {level!r}; known: {', '.join(known)}"]


class PathDistribution(Distribution):
    """Log-probability and entropy of one sample whose parts depend on each other.

    Where each part is drawn given the parts before it, the density of a sample needs a
    network's pass over that very sample. It was made when this was built: PPO losses
    ask for the log-probability when the parameters that they lent the actor are gone.

    Args:
        path: the sample, [*B, ...].
        log_prob: its log-probability, [*B] or finer.
        entropy: sum of the entropies of all parts given those before, same shape, or
            what computes it; its mean over samples is the entropy. None where there is
            none.

    Example:
        >>> path = torch.tensor([[2, 0]])
        >>> dist = PathDistribution(path, torch.tensor([-1.5]), None)
        >>> dist.log_prob(path)
        tensor([-1.5000])
    """

    arg_constraints: ClassVar[dict[str, Any]] = {}
    has_rsample = False

    def __init__(
        self,
        path: torch.Tensor,
        log_prob: torch.Tensor,
        entropy: torch.Tensor | Callable[[], torch.Tensor] | None,
    ) -> None:
        self._path, self._log_prob, self._entropy = path, log_prob, entropy
        events = path.shape[log_prob.ndim :]
        super().__init__(log_prob.shape, events, validate_args=False)

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """Return the log-probability of the sample that this was built for.

        Raises:
            DataError: another sample.
        """
        # A lazily stacked TensorDict makes a new tensor at each reading.
        if value is not self._path and not torch.equal(value, self._path):
            raise DataError(
                "the log-probability of another sample than the batch holds was asked "
                "for; put the sample into the batch, then call get_dist(batch)."
            )
        return self._log_prob

    def entropy(self) -> torch.Tensor:
        """Return the entropies along the sample, summed.

        Raises:
            ConfigError: this kind of log-probability comes with none.
        """
        if self._entropy is None:
            raise ConfigError(
                ["this log-probability has no entropy; build PPO with entropy_bonus=0"]
            )
        return self._entropy() if callable(self._entropy) else self._entropy


def stored_sample(tensordict: TensorDictBase) -> torch.Tensor:
    """Return the batch's sample.

    Raises:
        DataError: there is none.
    """
    sample = tensordict.get(SAMPLE, None)
    if sample is None:
        raise DataError(
            f"the batch has no {SAMPLE!r}, and a density that depends on earlier parts "
            "of a sample needs one; call the policy first, or keep its sample."
        )
    path: torch.Tensor = sample
    return path
