"""What an OpenVLA checkpoint folder says of its model, in ``config.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rlco.errors import CheckpointError, UnknownNameError

#: The image encoders of openvla-7b under their names in timm: the sizes there, in the
#: words of transformers. One block less than published: its output is not used.
VISION: dict[str, dict[str, Any]] = {
    "vit_large_patch14_reg4_dinov2.lvd142m": {
        "hidden_size": 1024,
        "num_hidden_layers": 23,
        "num_attention_heads": 16,
        "mlp_ratio": 4,
        "patch_size": 14,
        "num_register_tokens": 4,
    },
    "vit_so400m_patch14_siglip_224": {
        "hidden_size": 1152,
        "num_hidden_layers": 26,
        "num_attention_heads": 16,
        "intermediate_size": 4304,
        "patch_size": 14,
        # The exact GELU of timm 0.9, with which OpenVLA was trained.
        "hidden_act": "gelu",
    },
}
#: Mean and standard deviation of each encoder's pixels, red, green and blue.
PIXELS = (
    ((0.484375, 0.455078125, 0.40625), (0.228515625, 0.2236328125, 0.224609375)),
    ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5)),
)


@dataclass(frozen=True)
class OpenVLAConfig:
    """Sizes, vocabulary and statistics.

    Attributes:
        dinov2: sizes of the first image encoder, in transformers' words.
        siglip: sizes of the second.
        image_size: pixels along each side of what both see.
        text: Llama's configuration.
        vocabulary: tokens before padding; the last ``bins`` of them are actions.
        bins: edges of an action number's bins.
        norm_stats: statistics of each data set, ``{name: {"action": {"q01": ...}}}``.
        empty_token: the token that ends a prompt, Llama's empty word.
        pad_token: what fills prompts up.
    """

    dinov2: dict[str, Any]
    siglip: dict[str, Any]
    image_size: int
    text: dict[str, Any]
    vocabulary: int
    bins: int = 256
    norm_stats: dict[str, Any] = field(default_factory=dict)
    empty_token: int = 29871
    pad_token: int = 32000

    @property
    def first_action_token(self) -> int:
        """The lowest token that means an action."""
        return self.vocabulary - self.bins


def read_config(folder: Path) -> OpenVLAConfig:
    """Read ``config.json`` of a checkpoint folder.

    Raises:
        CheckpointError: it is missing, of another model, or of other image encoders.
    """
    path = folder / "config.json"
    try:
        raw = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise CheckpointError(
            f"cannot read {str(path)!r} ({error}); give a folder that holds OpenVLA's "
            "config.json and its safetensors files."
        ) from error
    if raw.get("model_type") != "openvla":
        raise CheckpointError(
            f"{str(path)!r} is of the type {raw.get('model_type')!r}, not 'openvla'; "
            "LeRobot's policies are loaded by load_lerobot."
        )
    sizes = raw.get("rlco_vision") or [_vision(name) for name in raw["timm_model_ids"]]
    if len(sizes) != 2 or len(set(raw["image_sizes"])) != 1:
        raise CheckpointError(
            f"{str(path)!r} has {len(sizes)} image encoders for sizes "
            f"{raw['image_sizes']}; rlco knows OpenVLA's pair, DINOv2 and SigLIP, on "
            "images of one size."
        )
    return OpenVLAConfig(
        dinov2=sizes[0],
        siglip=sizes[1],
        image_size=raw["image_sizes"][0],
        text=raw["text_config"],
        vocabulary=raw["text_config"]["vocab_size"] - raw["pad_to_multiple_of"],
        bins=raw["n_action_bins"],
        norm_stats=raw.get("norm_stats") or {},
        empty_token=raw.get("rlco_empty_token", 29871),
        pad_token=raw["pad_token_id"],
    )


def _vision(name: str) -> dict[str, Any]:
    if name not in VISION:
        raise UnknownNameError("image encoder", name, list(VISION))
    return VISION[name]


@dataclass(frozen=True)
class ActionRange:
    """The quantiles that OpenVLA's normalised actions -1 and 1 stand for.

    Attributes:
        low: 1 % quantile of each action number, raw units, shape (A,).
        high: 99 % quantile.
        mask: which numbers are normalised at all; a gripper is not.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    mask: tuple[bool, ...]


def action_range(
    norm_stats: Mapping[str, Any], name: str | None, *, action_size: int
) -> ActionRange:
    """Return the statistics of a data set.

    Args:
        norm_stats: those of the checkpoint.
        name: which data set's; None where there is one.
        action_size: A, action dimensions of the robot.

    Raises:
        CheckpointError: there are none of that name, or of another action size.

    Example:
        >>> stats = {"push": {"action": {"q01": [-1.0, 0.0], "q99": [1.0, 1.0]}}}
        >>> action_range(stats, None, action_size=2).low
        (-1.0, 0.0)
    """
    known = ", ".join(norm_stats) or "none"
    if name is None and len(norm_stats) == 1:
        (name,) = norm_stats
    if name is None or name not in norm_stats:
        raise CheckpointError(
            f"the checkpoint has no statistics of {name!r} to un-normalise actions "
            f"with (it has: {known}); name one of them by unnorm_key=, or give "
            "action_quantiles= of your own data."
        )
    stats = norm_stats[name]["action"]
    low, high = np.asarray(stats["q01"], float), np.asarray(stats["q99"], float)
    if low.shape != (action_size,) or high.shape != (action_size,):
        raise CheckpointError(
            f"the checkpoint's statistics of {name!r} are of {low.size} action "
            f"dimensions, those of the robot or task are {action_size}; give another "
            "unnorm_key=, or a checkpoint that was trained on this robot."
        )
    mask = stats.get("mask", [True] * action_size)
    return ActionRange(tuple(low.tolist()), tuple(high.tolist()), tuple(mask))
