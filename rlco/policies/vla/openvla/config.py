"""What an OpenVLA checkpoint folder says of its model, in ``config.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rlco.errors import CheckpointError, UnknownNameError
from rlco.files import Fields, read_json, shown
from rlco.files.fields import is_number

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
        CheckpointError: it is missing or damaged, of another model, or of other image
            encoders, or an entry is not of the type that OpenVLA's is.
        UnknownNameError: of an image encoder that rlco does not know.
    """
    path = folder / "config.json"
    raw = read_json(
        path,
        advice="give a folder that holds OpenVLA's config.json and its safetensors "
        "files",
        error=CheckpointError,
    )
    kind = raw.content.get("model_type")
    if kind != "openvla":
        raise CheckpointError(
            f"{str(path)!r} is of the type {shown(kind)}, not 'openvla'; "
            "LeRobot's policies are loaded by load_lerobot."
        )
    sizes = _vision_sizes(raw)
    image_sizes = raw.sequence("image_sizes")
    if not image_sizes or not all(isinstance(size, int) for size in image_sizes):
        raise raw.refuse("image_sizes", "a list of whole numbers")
    if len(sizes) != 2 or len(set(image_sizes)) != 1:
        raise CheckpointError(
            f"{str(path)!r} has {len(sizes)} image encoders for sizes "
            f"{shown(image_sizes)}; rlco knows OpenVLA's pair, DINOv2 and SigLIP, on "
            "images of one size."
        )
    text = raw.group("text_config")
    return OpenVLAConfig(
        dinov2=sizes[0],
        siglip=sizes[1],
        image_size=image_sizes[0],
        text=raw.mapping("text_config"),
        vocabulary=text.integer("vocab_size", minimum=1)
        - raw.integer("pad_to_multiple_of", minimum=0),
        bins=raw.integer("n_action_bins", minimum=1),
        norm_stats=raw.mapping("norm_stats", {}),
        empty_token=raw.integer("rlco_empty_token", 29871, minimum=0),
        pad_token=raw.integer("pad_token_id", minimum=0),
    )


def _vision_sizes(raw: Fields) -> list[dict[str, Any]]:
    """Return the image encoders' sizes, in transformers' words."""
    if not raw.sequence("rlco_vision", []):
        return [_vision(name, raw) for name in raw.sequence("timm_model_ids")]
    found = raw.groups("rlco_vision")
    for one in found:
        one.integer("hidden_size", minimum=1)
        one.integer("patch_size", minimum=1)
    return [dict(one.content) for one in found]


def _vision(name: object, raw: Fields) -> dict[str, Any]:
    if not isinstance(name, str):
        raise raw.refuse("timm_model_ids", "a list of names")
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
        CheckpointError: there are none of that name, or of another action size, or
            they are no numbers.

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
    stats = Fields(
        norm_stats[name],
        f"the checkpoint's statistics of {name!r}",
        CheckpointError,
        "correct its config.json, or copy the folder again",
    ).group("action")
    low, high = _quantile(stats, "q01"), _quantile(stats, "q99")
    if len(low) != action_size or len(high) != action_size:
        raise CheckpointError(
            f"the checkpoint's statistics of {name!r} are of {len(low)} action "
            f"dimensions, those of the robot or task are {action_size}; give another "
            "unnorm_key=, or a checkpoint that was trained on this robot."
        )
    mask = stats.sequence("mask", [True] * action_size)
    if len(mask) != action_size or not all(isinstance(one, bool) for one in mask):
        raise stats.refuse("mask", f"a list of true and false, {action_size} of them")
    return ActionRange(low, high, tuple(mask))


def _quantile(stats: Fields, key: str) -> tuple[float, ...]:
    found = stats.sequence(key)
    if not all(is_number(one) for one in found):
        raise stats.refuse(key, "a list of numbers")
    return tuple(float(one) for one in found)
