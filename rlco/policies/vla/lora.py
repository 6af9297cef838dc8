"""Low-rank adapters inside a model, by peft, and the model with them merged in."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import torch
from peft import LoraConfig, inject_adapter_in_model
from peft.tuners.lora import LoraLayer
from peft.tuners.tuners_utils import cast_adapter_dtype
from torch import nn

from rlco.errors import ConfigError

log = logging.getLogger(__name__)

_BASE = ".base_layer."
_ADAPTER = "default"  # peft's name for an only one
#: A larger share of the adapters' change that merging rounds away is reported.
_ROUNDED_AWAY = 0.1


def add_lora(
    model: nn.Module,
    targets: Sequence[nn.Module],
    *,
    rank: int,
    alpha: int | None = None,
) -> None:
    """Put trainable adapters beside every linear layer of some modules, in place.

    All other weights of the model lose their gradient (Hu et al., arXiv 2106.09685).
    The model computes what it computed before: adapters start at 0. They are float32
    where the model's weights are of 16 bits, as small steps would round to nothing.

    Args:
        model: whose names and gradients are meant.
        targets: modules of it, or linear layers themselves.
        rank: r.
        alpha: scales the adapters by alpha / r; None: r.

    Raises:
        ConfigError: a rank below 1, or no linear layer in the targets.

    Example:
        >>> model = nn.Sequential(nn.Linear(3, 4), nn.ReLU(), nn.Linear(4, 2))
        >>> add_lora(model, [model[2]], rank=1)
        >>> [name for name, p in model.named_parameters() if p.requires_grad]
        ['2.lora_A.default.weight', '2.lora_B.default.weight']
    """
    if rank < 1:
        raise ConfigError([f"lora_rank={rank} must be at least 1"])
    wanted = {id(part) for target in targets for part in target.modules()}
    names = [
        name
        for name, part in model.named_modules()
        if id(part) in wanted and isinstance(part, nn.Linear)
    ]
    if not names:
        raise ConfigError(["there is no linear layer to put adapters beside"])
    for parameter in model.parameters():
        parameter.requires_grad_(False)
    config = LoraConfig(r=rank, lora_alpha=alpha or rank, target_modules=names)
    inject_adapter_in_model(config, model)
    cast_adapter_dtype(model, _ADAPTER)


def merged_state(model: nn.Module) -> dict[str, torch.Tensor]:
    """Return a model's state under the names that it had without adapters.

    Adapters are added to the weights beside them; the model itself stays as it is.
    Weights of 16 bits hold a small change only roughly: what is lost of it is logged
    where that is more than a tenth.
    """
    state = {
        name.replace(_BASE, "."): value
        for name, value in model.state_dict().items()
        if not _is_adapter(name)
    }
    adapted: dict[str, Any] = {
        f"{name}.weight": part
        for name, part in model.named_modules()
        if isinstance(part, LoraLayer)
    }
    lost, whole = 0.0, 0.0
    for name, part in adapted.items():
        weight = state[name].float()
        delta = part.get_delta_weight(_ADAPTER).detach().float()
        merged = (weight + delta).to(state[name].dtype)
        lost += float((merged.float() - weight - delta).square().sum())
        whole += float(delta.square().sum())
        state[name] = merged
    if lost > _ROUNDED_AWAY**2 * whole:
        log.warning(
            "merged into weights of 16 bits, the adapters' change is off by %.0f %% of "
            "its size, so that what is saved acts differently from what was trained; "
            "load the checkpoint in float32, or train longer or with a larger lr.",
            100 * (lost / whole) ** 0.5,
        )
    return state


def has_lora(model: nn.Module) -> bool:
    """Return whether a model has adapters."""
    return any(isinstance(part, LoraLayer) for part in model.modules())


def without_lora(model: nn.Module) -> list[nn.Parameter]:
    """Return a model's own weights, in their order, trained or not."""
    return [p for name, p in model.named_parameters() if not _is_adapter(name)]


def _is_adapter(name: str) -> bool:
    return ".lora_" in name
