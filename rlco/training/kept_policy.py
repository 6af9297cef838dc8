"""Which policy of Stage II is saved: the last, or that of the best evaluation."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from rlco.errors import ConfigError
from rlco.physics.spec.domain import make_domain

log = logging.getLogger("rlco.training")


class KeepOptions(Protocol):
    """Options that say which policy is saved.

    Attributes:
        keep: ``last``, or ``best``: by success in the training domain.
        train_domain: A domain's name or file.
    """

    keep: Literal["last", "best"]
    train_domain: str


@dataclass
class BestPolicy:
    """A policy's weights at its best evaluation so far; of equal ones the earliest.

    Attributes:
        policy: What is trained; offers ``state_dict``.
        column: What evaluations are compared by, a column of metrics.csv.
        rollout: When the best evaluation was; None before the first.
        success: What it measured, in [0, 1].
        weights: The policy's then.

    Example:
        >>> import torch
        >>> policy = torch.nn.Linear(1, 1, bias=False)
        >>> best = BestPolicy(policy, "success_sim")
        >>> for rollout, rate in enumerate([0.5, 0.75, 0.75]):
        ...     _ = policy.weight.data.fill_(rollout)
        ...     best.offer(rollout, {"success_sim": rate})
        >>> best.restore()
        >>> best.rollout, policy.weight.item()
        (1, 1.0)
    """

    policy: Any
    column: str
    rollout: int | None = None
    success: float = 0.0
    weights: dict[str, Any] = field(default_factory=dict)

    def offer(self, rollout: int, row: Mapping[str, Any]) -> None:
        """Keep the policy's weights if a row holds a better evaluation of it."""
        if self.column not in row:
            return
        success = float(row[self.column])
        if self.rollout is None or success > self.success:
            self.rollout, self.success = rollout, success
            self.weights = deepcopy(dict(self.policy.state_dict()))

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint holds."""
        return {
            "rollout": self.rollout,
            "success": self.success,
            "weights": self.weights,
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Go on from a checkpoint."""
        self.rollout, self.success = state["rollout"], state["success"]
        self.weights = state["weights"]

    def restore(self) -> None:
        """Give the policy the weights of its best evaluation, and say which it was."""
        self.policy.load_state_dict(self.weights)
        log.info(
            "keep=best: the policy of rollout %s, %s %.1f %%",
            self.rollout,
            self.column,
            100 * self.success,
        )

    def description(self) -> dict[str, Any]:
        """Return what a user of the saved policy must know of the choice."""
        return {
            "keep": "best",
            "kept_rollout": self.rollout,
            f"kept_{self.column}": self.success,
        }


def check_keep(options: KeepOptions, evaluated: Collection[str]) -> None:
    """Check that what ``keep=best`` compares is measured.

    Args:
        options: See `KeepOptions`.
        evaluated: Names of the domains of evaluations.

    Raises:
        ConfigError: The training domain is not among them.
    """
    if options.keep == "best" and make_domain(options.train_domain).name not in (
        evaluated
    ):
        raise ConfigError(
            [
                "keep=best chooses by success in the training domain; give "
                f"eval_domains=[{options.train_domain}] (others may follow) and "
                "eval_episodes above 0, or keep=last"
            ]
        )


def best_policy(options: KeepOptions, policy: Any) -> BestPolicy | None:
    """Return what keeps the best policy; None where the last one is saved."""
    if options.keep == "last":
        return None
    return BestPolicy(policy, f"success_{make_domain(options.train_domain).name}")
