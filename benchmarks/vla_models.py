"""The models of vla_step.py: tiny ones, and the real sizes with random weights."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.pi05.configuration_pi05 import PI05Config
from lerobot.policies.pi05.modeling_pi05 import PI05Policy, PI05Pytorch
from lerobot.policies.pretrained import PreTrainedPolicy
from tensordict import TensorDict, TensorDictBase

from rlco.policies.tiny.openvla import write_tiny_openvla
from rlco.policies.tiny.pi05 import write_tiny_pi05
from rlco.policies.tiny.processor_tiny_pi05 import make_tiny_pi05_pre_post_processors
from rlco.policies.tiny.tokenizer import write_tokenizer
from rlco.policies.vla.lerobot.checkpoint import LeRobotCheckpoint, load_lerobot
from rlco.policies.vla.lerobot.pi05 import Pi05Model
from rlco.policies.vla.lerobot.policy import LeRobotPolicy
from rlco.policies.vla.lerobot.trained_weights import add_expert_lora
from rlco.policies.vla.lora import add_lora
from rlco.policies.vla.openvla.config import VISION, OpenVLAConfig
from rlco.policies.vla.openvla.load import load_openvla
from rlco.policies.vla.openvla.model import OpenVLA
from rlco.policies.vla.openvla.policy import OpenVLAPolicy

INSTRUCTIONS = ("push the blue cube onto its mark",)
OPENVLA_7B = OpenVLAConfig(
    dinov2=VISION["vit_large_patch14_reg4_dinov2.lvd142m"],
    siglip=VISION["vit_so400m_patch14_siglip_224"],
    image_size=224,
    text={"vocab_size": 32064, "pad_token_id": 32000},
    vocabulary=32000,
    # The tiny tokenizer knows no more words; the sizes are what counts.
    empty_token=2,
)
Actor = Any


class OnMeta(PI05Policy):
    """LeRobot's pi0.5 without memory for its weights."""

    def __init__(self, config: PI05Config) -> None:
        PreTrainedPolicy.__init__(self, config)
        self.config, self.rtc_processor = config, None
        with torch.device("meta"):
            self.model = PI05Pytorch(config)
        self.reset()


def pi05_config(**options: Any) -> PI05Config:
    """Return the published sizes, one camera, as RL-Co uses them: chunks of 8."""
    camera = PolicyFeature(FeatureType.VISUAL, (3, 224, 224))
    return PI05Config(
        input_features={
            "observation.images.front": camera,
            "observation.state": PolicyFeature(FeatureType.STATE, (7,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (7,))},
        chunk_size=8,
        n_action_steps=4,
        num_inference_steps=4,
        push_to_hub=False,
        **options,
    )


def real_pi05() -> LeRobotCheckpoint:
    """Return pi0.5 in bfloat16 with random weights on the accelerator."""
    config = pi05_config(device="cuda", dtype="bfloat16")
    config.tokenizer = tempfile.mkdtemp()
    write_tokenizer(config.tokenizer, begin=True)
    with torch.device("cuda"):
        policy = PI05Policy(config)
    processors = make_tiny_pi05_pre_post_processors(config)
    return LeRobotCheckpoint(Path(config.tokenizer), Pi05Model(policy), *processors)


def tiny_pi05() -> LeRobotCheckpoint:
    """Return the tiny pi0.5."""
    return load_lerobot(write_tiny_pi05(tempfile.mkdtemp()))


def pi05_modes(load: Callable[[], LeRobotCheckpoint]) -> dict[str, Callable[[], Actor]]:
    """Return what is trained, and whether the prefix is kept, each to be built."""

    def actor(**options: Any) -> LeRobotPolicy:
        return LeRobotPolicy(load(), instructions=INSTRUCTIONS, steps=4, **options)

    def adapted() -> LeRobotPolicy:
        policy = actor()
        add_expert_lora(policy.model, rank=16)
        return policy

    return {
        "pi0.5, expert, prefix computed anew": lambda: actor(keep_prefix=False),
        "pi0.5, expert, prefix kept": actor,
        "pi0.5, LoRA on the expert, prefix kept": adapted,
        "pi0.5, all weights": lambda: actor(trained="full"),
    }


def real_openvla() -> tuple[OpenVLA, Path]:
    """Return openvla-7b in bfloat16 with random weights on the accelerator."""
    kept = torch.get_default_dtype()
    torch.set_default_dtype(torch.bfloat16)
    with torch.device("cuda"):
        model = OpenVLA(OPENVLA_7B)
    torch.set_default_dtype(kept)
    folder = Path(tempfile.mkdtemp())
    write_tokenizer(folder, begin=True)
    return model, folder


def tiny_openvla() -> tuple[OpenVLA, Path]:
    """Return the tiny OpenVLA."""
    folder = write_tiny_openvla(tempfile.mkdtemp())
    return load_openvla(folder, dtype=torch.float32), folder


def openvla_modes(
    load: Callable[[], tuple[OpenVLA, Path]],
) -> dict[str, Callable[[], Actor]]:
    """Return what is trained, each to be built."""

    def actor() -> OpenVLAPolicy:
        model, folder = load()
        quantiles = ([-1.0] * 7, [1.0] * 7)
        return OpenVLAPolicy(
            model,
            instructions=INSTRUCTIONS,
            tokenizer=folder,
            action_quantiles=quantiles,
        )

    def adapted() -> OpenVLAPolicy:
        policy = actor()
        add_lora(policy.model, [policy.model], rank=32)
        return policy

    return {"OpenVLA, LoRA": adapted, "OpenVLA, all weights": actor}


def rows(count: int, *, chunk: int, size: int) -> TensorDictBase:
    """Draw observations and demonstrated chunks."""
    return TensorDict(
        {
            "observation": {
                "state": torch.rand(count, 7) * 2 - 1,
                "image": torch.randint(256, (count, 3, size, size), dtype=torch.uint8),
            },
            "instruction_id": torch.zeros(count, dtype=torch.int64),
            "vla_action": {"chunk": torch.rand(count, chunk, 7) * 2 - 1},
        },
        [count],
    )
