"""A tiny OpenVLA under the published names."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file

from rlco.policies.tiny.tokenizer import write_tokenizer
from rlco.policies.vla.openvla.config import read_config
from rlco.policies.vla.openvla.model import OpenVLA
from rlco.policies.vla.openvla.weight_names import to_published, vision_table

_CONFIG: dict[str, Any] = {
    "model_type": "openvla",
    "timm_model_ids": [
        "vit_large_patch14_reg4_dinov2.lvd142m",
        "vit_so400m_patch14_siglip_224",
    ],
    "image_sizes": [28, 28],
    "n_action_bins": 256,
    "pad_token_id": 768,
    "pad_to_multiple_of": 64,
    "rlco_empty_token": 2,
    "rlco_vision": [
        {
            "hidden_size": 32,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "mlp_ratio": 2,
            "patch_size": 14,
            "num_register_tokens": 4,
        },
        {
            "hidden_size": 48,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "intermediate_size": 64,
            "patch_size": 14,
            "hidden_act": "gelu",
        },
    ],
    "text_config": {
        "vocab_size": 832,
        "hidden_size": 64,
        "intermediate_size": 128,
        "num_hidden_layers": 2,
        "num_attention_heads": 4,
        "pad_token_id": 768,
    },
}


def write_tiny_openvla(
    folder: str | os.PathLike[str], *, action_size: int = 7, seed: int = 0
) -> Path:
    """Write a folder with openvla-7b's names and random weights.

    Args:
        folder: where to; made where it does not exist.
        action_size: action dimensions A of its statistics.
        seed: draws the weights.

    Returns:
        The folder.
    """
    path = Path(folder).resolve()
    write_tokenizer(path, begin=True)
    action = {
        "q01": [-0.5] * action_size,
        "q99": [0.5] * action_size,
        "mask": [True] * (action_size - 1) + [False],
    }
    raw = {**_CONFIG, "norm_stats": {"tiny": {"action": action}}}
    (path / "config.json").write_text(json.dumps(raw, indent=2) + "\n", "utf-8")
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = OpenVLA(read_config(path))
        unused = _unused()
    weights = model.state_dict()
    published = {
        name: to_published(entry, weights).contiguous()
        for name, entry in vision_table(model.config).items()
    }
    published |= {k: v for k, v in weights.items() if k.startswith("language_model.")}
    save_file(published | unused, path / "model.safetensors")
    return path


def _unused() -> dict[str, torch.Tensor]:
    """Return a few of the weights that are published and not used."""
    return {
        "vision_backbone.featurizer.norm.weight": torch.randn(32),
        "vision_backbone.featurizer.blocks.2.norm1.bias": torch.randn(32),
        "vision_backbone.fused_featurizer.attn_pool.latent": torch.randn(1, 1, 48),
    }
