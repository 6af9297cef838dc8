"""What LeRobot must know to build one of rlco's policies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig


@PreTrainedConfig.register_subclass("rlco")
@dataclass
class RlcoConfig(PreTrainedConfig):
    """A policy of rlco by its kind and its constructor's arguments.

    Attributes:
        kind: "gaussian", "token" or "flow".
        arguments: as JSON, which LeRobot's parser leaves alone.
        instructions: texts in the order of their ids.
        n_action_steps: steps of a chunk that are executed before the next.
        lr: learning rate of ``lerobot-train``.
    """

    kind: str = "gaussian"
    arguments: str = "{}"
    instructions: list[str] = field(default_factory=list)
    n_action_steps: int = 1
    lr: float = 3e-4
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: dict.fromkeys(
            ("VISUAL", "STATE", "ENV", "ACTION"), NormalizationMode.IDENTITY
        )
    )

    def validate_features(self) -> None:
        """Accept every feature: the arguments say what is read."""

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return what ``lerobot-train`` optimises with."""
        return AdamWConfig(lr=self.lr, weight_decay=0.0)

    def get_scheduler_preset(self) -> None:
        """Return no schedule."""

    @property
    def observation_delta_indices(self) -> None:
        """Only the present is read."""

    @property
    def action_delta_indices(self) -> list[int]:
        """Return which actions of a data set make a chunk."""
        import json

        arguments: dict[str, Any] = json.loads(self.arguments)
        return list(range(arguments["chunk"]))

    @property
    def reward_delta_indices(self) -> None:
        """No reward is read."""
