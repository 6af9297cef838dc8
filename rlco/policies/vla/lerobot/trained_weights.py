"""Which weights of a LeRobot policy are trained."""

from __future__ import annotations

from typing import Literal

from torch import nn

from rlco.policies.vla.lerobot.flow_model import FlowModel
from rlco.policies.vla.lora import add_lora

#: What follows images and text, or all that LeRobot's configuration trains.
Trained = Literal["expert", "full"]


def freeze(model: FlowModel, trained: Trained) -> None:
    """Leave what is not trained, and what is never used, without gradient."""
    modules = list(model.unused_modules())
    if trained == "expert":
        modules += model.prefix_modules()
    for module in modules:
        module.requires_grad_(False)


def add_expert_lora(model: FlowModel, *, rank: int) -> None:
    """Train low-rank adapters beside the expert's linear layers, and nothing else.

    Raises:
        ConfigError: a rank below 1.
    """
    spared = [*model.prefix_modules(), *model.unused_modules()]
    left_out = {id(part) for module in spared for part in module.modules()}
    parts = [p for p in model.policy.modules() if id(p) not in left_out]
    linear = [part for part in parts if isinstance(part, nn.Linear)]
    add_lora(model.policy, linear, rank=rank)
