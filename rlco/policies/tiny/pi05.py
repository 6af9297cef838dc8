"""A checkpoint folder of the tiny pi0.5."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import make_pre_post_processors

from rlco.policies.tiny.configuration_tiny_pi05 import TinyPI05Config
from rlco.policies.tiny.modeling_tiny_pi05 import TinyPI05Policy
from rlco.policies.tiny.smolvla import Stats, unit_stats
from rlco.policies.tiny.tokenizer import write_tokenizer


def write_tiny_pi05(
    folder: str | os.PathLike[str],
    *,
    action_size: int = 7,
    state_size: int = 7,
    camera: str = "observation.images.front",
    image_size: int = 64,
    stats: Stats | None = None,
    seed: int = 0,
    **options: Any,
) -> Path:
    """Write a checkpoint folder of the type ``tiny_pi05`` with random weights.

    Args:
        folder: where to; made where it does not exist.
        action_size: action dimensions A.
        state_size: dimension of the state.
        camera: LeRobot's name of the camera.
        image_size: pixels along each side of its frames.
        stats: statistics for the processors; by default normalisation does nothing.
        seed: draws the weights.
        **options: of the configuration, ``dtype="bfloat16"`` for instance.

    Returns:
        The folder.
    """
    path = Path(folder).resolve()
    write_tokenizer(path / "tokenizer", begin=True)
    config = TinyPI05Config(
        input_features={
            camera: PolicyFeature(FeatureType.VISUAL, (3, image_size, image_size)),
            "observation.state": PolicyFeature(FeatureType.STATE, (state_size,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (action_size,))},
        tokenizer=str(path / "tokenizer"),
        device="cpu",
        push_to_hub=False,
        **options,
    )
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        policy = TinyPI05Policy(config)
    policy.save_pretrained(path)
    stats = stats or unit_stats(state_size, action_size)
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(path)
    return path
