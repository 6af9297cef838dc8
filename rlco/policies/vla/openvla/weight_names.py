"""The names of openvla-7b's published weights, and where they go.

Published are timm's names for the image encoders, with one matrix for query, key and
value, and the originals' names for everything else.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import torch

from rlco.policies.vla.openvla.config import OpenVLAConfig

_KINDS = ("weight", "bias")
_ENCODERS = {
    "vision_backbone.featurizer": "dinov2",
    "vision_backbone.fused_featurizer": "siglip",
}
#: Outside the blocks of each encoder: timm's name and transformers'.
_OUTSIDE = {
    "dinov2": {
        "cls_token": "embeddings.cls_token",
        "reg_token": "embeddings.register_tokens",
        "pos_embed": "embeddings.position_embeddings",
        "patch_embed.proj.weight": "embeddings.patch_embeddings.projection.weight",
        "patch_embed.proj.bias": "embeddings.patch_embeddings.projection.bias",
    },
    "siglip": {
        "pos_embed": "vision_model.embeddings.position_embedding.weight",
        "patch_embed.proj.weight": "vision_model.embeddings.patch_embedding.weight",
        "patch_embed.proj.bias": "vision_model.embeddings.patch_embedding.bias",
    },
}
_BLOCKS = {"dinov2": "encoder.layer", "siglip": "vision_model.encoder.layers"}
#: Inside a block, each with a weight and a bias.
_INSIDE = {
    "dinov2": {
        "norm1": "norm1",
        "norm2": "norm2",
        "attn.proj": "attention.output.dense",
        "mlp.fc1": "mlp.fc1",
        "mlp.fc2": "mlp.fc2",
    },
    "siglip": {
        "norm1": "layer_norm1",
        "norm2": "layer_norm2",
        "attn.proj": "self_attn.out_proj",
        "mlp.fc1": "mlp.fc1",
        "mlp.fc2": "mlp.fc2",
    },
}
_ATTENTION = {
    "dinov2": tuple(
        f"attention.attention.{part}" for part in ("query", "key", "value")
    ),
    "siglip": tuple(f"self_attn.{part}_proj" for part in "qkv"),
}
_PROJECTOR = {"fc1": "0", "fc2": "2", "fc3": "4"}


@dataclass(frozen=True)
class Entry:
    """One published weight.

    Attributes:
        native: its names in :class:`rlco.policies.vla.openvla.model.OpenVLA`.
        form: "same"; "fused", as many as there are names, one below the other; "no
            class", without the class token's row, which timm does not have, and
            "class", that token with its row added; "row", with a first axis of 1 more.
    """

    native: tuple[str, ...]
    form: Literal["same", "fused", "no class", "class", "row"] = "same"


def vision_table(config: OpenVLAConfig) -> dict[str, Entry]:
    """Return every published weight but the language model's, whose names are kept."""
    table = {
        f"projector.{name}.{kind}": Entry((f"projector.{layer}.{kind}",))
        for name, layer in _PROJECTOR.items()
        for kind in _KINDS
    }
    for prefix, encoder in _ENCODERS.items():
        for name, inner in _OUTSIDE[encoder].items():
            table[f"{prefix}.{name}"] = Entry((f"{encoder}.{inner}",))
        for block in range(getattr(config, encoder)["num_hidden_layers"]):
            ours = f"{encoder}.{_BLOCKS[encoder]}.{block}"
            table |= dict(_block(f"{prefix}.blocks.{block}", ours, encoder))
    dinov2, siglip = _ENCODERS
    place = table[f"{dinov2}.pos_embed"].native
    table[f"{dinov2}.pos_embed"] = Entry(place, "no class")
    token = table[f"{dinov2}.cls_token"].native
    table[f"{dinov2}.cls_token"] = Entry((*token, *place), "class")
    table[f"{siglip}.pos_embed"] = Entry(table[f"{siglip}.pos_embed"].native, "row")
    return table


def _block(theirs: str, ours: str, encoder: str) -> Iterator[tuple[str, Entry]]:
    for kind in _KINDS:
        parts = tuple(f"{ours}.{part}.{kind}" for part in _ATTENTION[encoder])
        yield f"{theirs}.attn.qkv.{kind}", Entry(parts, "fused")
        for name, inner in _INSIDE[encoder].items():
            yield f"{theirs}.{name}.{kind}", Entry((f"{ours}.{inner}.{kind}",))
    if encoder == "dinov2":
        for i in (1, 2):
            scale = f"{ours}.layer_scale{i}.lambda1"
            yield f"{theirs}.ls{i}.scale_factor", Entry((scale,))


def is_unused(name: str, config: OpenVLAConfig) -> bool:
    """Return whether OpenVLA publishes a weight but never computes with it.

    Both encoders are read one block before their last, so the last block, the final
    normalisation and SigLIP's pooling have no effect on anything.
    """
    for prefix, encoder in _ENCODERS.items():
        if name.startswith(f"{prefix}."):
            rest = name.removeprefix(f"{prefix}.")
            if found := re.match(r"blocks\.(\d+)\.", rest):
                blocks: int = getattr(config, encoder)["num_hidden_layers"]
                return int(found.group(1)) >= blocks
            return rest.split(".")[0] in ("norm", "attn_pool")
    return False


def to_native(entry: Entry, value: torch.Tensor) -> dict[str, torch.Tensor]:
    """Give one published weight its native names and shapes.

    Example:
        >>> entry = Entry(("q", "k", "v"), "fused")
        >>> to_native(entry, torch.arange(3))["k"]
        tensor([1])
    """
    if entry.form == "fused":
        parts = value.chunk(len(entry.native))
        return dict(zip(entry.native, parts, strict=True))
    if entry.form == "no class":
        value = torch.cat([torch.zeros_like(value[:, :1]), value], 1)
    elif entry.form == "row":
        value = value[0]
    return {entry.native[0]: value}


def to_published(entry: Entry, weights: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """Return one published weight of native ones, the inverse of ``to_native``."""
    if entry.form == "fused":
        return torch.cat([weights[name] for name in entry.native])
    value = weights[entry.native[0]]
    if entry.form == "class":
        return value + weights[entry.native[1]][:, :1]
    if entry.form == "no class":
        return value[:, 1:]
    return value[None] if entry.form == "row" else value
