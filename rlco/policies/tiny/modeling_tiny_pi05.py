"""A tiny pi0.5: LeRobot's classes, of which only ``__init__`` is another."""

from __future__ import annotations

from typing import Any

import torch
from lerobot.policies.pi05.modeling_pi05 import (
    PaliGemmaWithExpertModel,
    PI05Policy,
    PI05Pytorch,
)
from lerobot.policies.pi_gemma import (
    PaliGemmaForConditionalGenerationWithPiGemma,
    PiGemmaForCausalLM,
)
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import nn
from transformers import GemmaConfig, PaliGemmaConfig

from rlco.policies.tiny.configuration_tiny_pi05 import TinyPI05Config

_VOCABULARY = 512
_WIDTH, _EXPERT_WIDTH = 128, 32
# Eight heads stand in LeRobot's code.
_TEXT: dict[str, Any] = {
    "num_hidden_layers": 2,
    "num_attention_heads": 8,
    "num_key_value_heads": 1,
    "head_dim": 8,
    "vocab_size": _VOCABULARY,
    "hidden_activation": "gelu_pytorch_tanh",
}


class TinyPaliGemmaWithExpert(PaliGemmaWithExpertModel):
    """PaliGemma and its action expert, two narrow layers each."""

    def __init__(self, config: TinyPI05Config) -> None:
        nn.Module.__init__(self)
        self.freeze_vision_encoder = config.freeze_vision_encoder
        self.train_expert_only = config.train_expert_only
        text = {**_TEXT, "hidden_size": _WIDTH, "intermediate_size": 512}
        both = PaliGemmaConfig(
            text_config={
                "model_type": "gemma",
                "use_adarms": False,
                "adarms_cond_dim": None,
                **text,
            },
            vision_config={
                "model_type": "siglip_vision_model",
                "hidden_size": 48,
                "intermediate_size": 96,
                "num_hidden_layers": 2,
                "num_attention_heads": 2,
                "image_size": config.image_resolution[0],
                "patch_size": 14,
                "projection_dim": _WIDTH,
                "vision_use_head": False,
            },
            projection_dim=_WIDTH,
            image_token_index=_VOCABULARY,
        )
        self.paligemma = PaliGemmaForConditionalGenerationWithPiGemma(config=both)
        self.gemma_expert = PiGemmaForCausalLM(
            config=GemmaConfig(
                **_TEXT,
                hidden_size=_EXPERT_WIDTH,
                intermediate_size=64,
                use_adarms=True,
                adarms_cond_dim=_EXPERT_WIDTH,
            )
        )
        self.gemma_expert.model.embed_tokens = None
        self.to_bfloat16_for_selected_params(config.dtype)
        self._set_requires_grad()


class TinyPI05Pytorch(PI05Pytorch):
    """The flow model around it."""

    def __init__(self, config: TinyPI05Config, rtc_processor: Any = None) -> None:
        nn.Module.__init__(self)
        self.config, self.rtc_processor = config, rtc_processor
        self.paligemma_with_expert = TinyPaliGemmaWithExpert(config)
        self.action_in_proj = nn.Linear(config.max_action_dim, _EXPERT_WIDTH)
        self.action_out_proj = nn.Linear(_EXPERT_WIDTH, config.max_action_dim)
        self.time_mlp_in = nn.Linear(_EXPERT_WIDTH, _EXPERT_WIDTH)
        self.time_mlp_out = nn.Linear(_EXPERT_WIDTH, _EXPERT_WIDTH)
        self.gradient_checkpointing_enabled = False


class TinyPI05Policy(PI05Policy):
    """What LeRobot's commands load for the type ``tiny_pi05``."""

    config_class = TinyPI05Config
    name = "tiny_pi05"

    def __init__(self, config: TinyPI05Config, **kwargs: Any) -> None:
        del kwargs  # What LeRobot's factory passes to every policy.
        PreTrainedPolicy.__init__(self, config)
        config.validate_features()
        self.config = config
        self.init_rtc_processor()
        self.model = TinyPI05Pytorch(config, rtc_processor=self.rtc_processor)
        if config.gradient_checkpointing:
            self.model.gradient_checkpointing_enable()
        self.model.to(torch.device(config.device))
        self.reset()
