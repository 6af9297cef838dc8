"""pi0.5 as LeRobot has it, in the two halves that flow policies need."""

from __future__ import annotations

from typing import Any

import torch
from lerobot.policies.common.vla_utils import (
    make_att_2d_masks,
    prepare_attention_masks_4d,
)
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import nn

from rlco.policies.vla.lerobot.flow_model import Batch, FlowModel, refuse
from rlco.policies.vla.prefix_cache import Prefix


class Pi05Model(FlowModel):
    """The halves of ``lerobot.policies.pi05.PI05Policy``.

    The state enters as text, so the prefix is images and text alone, and the expert
    sees nothing but that prefix.

    Args:
        policy: LeRobot's policy, or a subclass that changes ``__init__`` alone.

    Raises:
        CheckpointError: the checkpoint predicts relative actions.
    """

    steps_option = "num_inference_steps"

    def __init__(self, policy: Any) -> None:
        config = policy.config
        if config.use_relative_actions:
            refuse(
                config.pretrained_path,
                "use_relative_actions=true",
                "whose log-probability depends on the state that LeRobot keeps aside",
            )
        self.policy = policy
        self.model = policy.model
        self.hidden_size: int = self.model.action_out_proj.in_features
        language = self._language_model()
        self.summary_size: int = language.config.hidden_size
        self.steps: int = getattr(config, self.steps_option)

    def _language_model(self) -> Any:
        return self.model.paligemma_with_expert.paligemma.model.language_model

    def prefix(self, batch: Batch) -> Prefix:
        """Pass images and text through PaliGemma, as LeRobot's sampling does."""
        images, image_masks = self.policy._preprocess_images(batch)
        embedded, mask, attends = self.model.embed_prefix(
            images,
            image_masks,
            batch[OBS_LANGUAGE_TOKENS],
            batch[OBS_LANGUAGE_ATTENTION_MASK],
        )
        attention = make_att_2d_masks(mask, attends)
        self._language_model().config._attn_implementation = "eager"
        (hidden, _), cache = self.model.paligemma_with_expert.forward(
            attention_mask=prepare_attention_masks_4d(attention),
            position_ids=torch.cumsum(mask, dim=1) - 1,
            past_key_values=None,
            inputs_embeds=[embedded, None],
            use_cache=True,
        )
        return Prefix.of(cache, mask, hidden)

    def prefix_modules(self) -> list[nn.Module]:
        """Return SigLIP, its projector and Gemma."""
        return [self.model.paligemma_with_expert.paligemma]

    def unused_modules(self) -> list[nn.Module]:
        """Return the expert's head over words, which is never called."""
        return [self.model.paligemma_with_expert.gemma_expert.lm_head]

    def gradient_checkpointing(self) -> bool:
        """Return whether it is on; it then leaves out the cache."""
        return bool(self.model.gradient_checkpointing_enabled)
