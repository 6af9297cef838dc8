"""Options of image encoders that learn positions from labelled scenes."""

from __future__ import annotations

from dataclasses import dataclass

from rlco.runs.config import RunOptions, option


@dataclass
class PretrainingOptions(RunOptions):
    """How an image encoder learns where things are."""

    pretrain_scenes: int = option(
        0,
        "scenes of the simulator, in random looks, from which the image encoder learns "
        "where things are before it imitates; 0: none",
        minimum=0,
    )
    pretrain_passes: int = option(
        20, "pretrain_scenes: how often each is learned from", minimum=1
    )
    pretrain_shift: float = option(
        0.05,
        "pretrain_scenes: largest shift of an image, share of the side; 0: images stay",
        minimum=0,
        maximum=0.25,
    )
    position_coeff: float = option(
        0.0,
        "weight of the loss of positions, read from images of simulated rows while "
        "imitating; 0: none",
        minimum=0,
    )
    image_fixed: bool = option(
        False, "imitate with the image encoder as it was pretrained; read images once"
    )
