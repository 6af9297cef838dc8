"""The configuration of a tiny pi0.5, under a type of its own.

LeRobot finds the model and the processors of a type by this file's name.
"""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig
from lerobot.policies.pi05.configuration_pi05 import PI05Config


@PreTrainedConfig.register_subclass("tiny_pi05")
@dataclass
class TinyPI05Config(PI05Config):
    """pi0.5's options; the published widths stand in the code, not here."""

    image_resolution: tuple[int, int] = (112, 112)
    chunk_size: int = 8
    n_action_steps: int = 4
    num_inference_steps: int = 4
    tokenizer_max_length: int = 48
    #: Folder of the tokenizer; the real type reads a gated one from the Hub.
    tokenizer: str = ""
