"""A tiny SmolVLA: the real classes, small by configuration alone."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy
from transformers import (
    SmolVLMConfig,
    SmolVLMImageProcessor,
    SmolVLMProcessor,
    SmolVLMVideoProcessor,
)

from rlco.policies.tiny.tokenizer import make_tokenizer

#: Tokens that SmolVLM's processor asks its tokenizer for.
_SPECIAL = {
    "image_token": "<image>",
    "fake_image_token": "<fake_token_around_image>",
    "global_image_token": "<global-img>",
}
Stats = Mapping[str, Mapping[str, Any]]


def unit_stats(state_size: int, action_size: int) -> dict[str, dict[str, torch.Tensor]]:
    """Return statistics that leave states and actions as they are."""
    return {
        key: {
            "mean": torch.zeros(size),
            "std": torch.ones(size),
            "q01": -torch.ones(size),
            "q99": torch.ones(size),
        }
        for key, size in (("observation.state", state_size), ("action", action_size))
    }


def write_tiny_smolvla(
    folder: str | os.PathLike[str],
    *,
    action_size: int = 7,
    state_size: int = 7,
    chunk: int = 8,
    executed: int = 4,
    camera: str = "observation.images.front",
    image_size: int = 64,
    stats: Stats | None = None,
    seed: int = 0,
) -> Path:
    """Write a checkpoint folder of LeRobot's type ``smolvla`` with random weights.

    It holds what LeRobot writes: ``config.json``, ``model.safetensors`` and both
    processors, and beside them ``vlm``, the folder of SmolVLM's configuration and
    tokenizer that the published model would find on the Hub.

    Args:
        folder: where to; made where it does not exist.
        action_size: action dimensions A.
        state_size: dimension of the state.
        chunk: predicted steps H of a chunk.
        executed: steps of it that are executed.
        camera: LeRobot's name of the camera.
        image_size: pixels along each side of its frames.
        stats: statistics for the processors; by default normalisation does nothing.
        seed: draws the weights.

    Returns:
        The folder.
    """
    path = Path(folder).resolve()
    write_vlm(path / "vlm", image_size=image_size)
    config = SmolVLAConfig(
        vlm_model_name=str(path / "vlm"),
        num_vlm_layers=4,
        resize_imgs_with_padding=(image_size, image_size),
        chunk_size=chunk,
        n_action_steps=executed,
        num_steps=4,
        tokenizer_max_length=24,
        input_features={
            camera: PolicyFeature(FeatureType.VISUAL, (3, image_size, image_size)),
            "observation.state": PolicyFeature(FeatureType.STATE, (state_size,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (action_size,))},
        device="cpu",
        push_to_hub=False,
    )
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        policy = SmolVLAPolicy(config)
    policy.save_pretrained(path)
    stats = stats or unit_stats(state_size, action_size)
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(path)
    return path


def write_vlm(folder: Path, *, image_size: int) -> None:
    """Write SmolVLM's configuration, tokenizer and processor."""
    tokenizer = make_tokenizer(special=_SPECIAL)
    SmolVLMConfig(
        vision_config={
            "hidden_size": 32,
            "intermediate_size": 64,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "image_size": image_size,
            "patch_size": 16,
        },
        text_config={
            "model_type": "llama",
            "vocab_size": 512,
            "hidden_size": 48,
            "intermediate_size": 96,
            "num_hidden_layers": 4,
            "num_attention_heads": 4,
            "num_key_value_heads": 2,
            "head_dim": 12,
        },
        scale_factor=2,
        image_token_id=tokenizer.convert_tokens_to_ids(_SPECIAL["image_token"]),
        pad_token_id=tokenizer.pad_token_id,
    ).save_pretrained(folder)
    SmolVLMProcessor(
        image_processor=SmolVLMImageProcessor(),
        tokenizer=tokenizer,
        video_processor=SmolVLMVideoProcessor(),
        image_seq_len=(image_size // 32) ** 2,
    ).save_pretrained(folder)
