"""SmolVLA as LeRobot has it, in the two halves that flow policies need."""

from __future__ import annotations

import copy
from typing import Any

import torch
from lerobot.policies.common.vla_utils import make_att_2d_masks
from lerobot.policies.factory import get_policy_class
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import nn

from rlco.policies.vla.lerobot.flow_model import Batch, FlowModel, refuse
from rlco.policies.vla.prefix_cache import Prefix


class SmolVLAModel(FlowModel):
    """The halves of ``lerobot.policies.smolvla.SmolVLAPolicy``.

    The state is the prefix's last position, by way of a projection that LeRobot trains
    together with the expert: to train the expert alone is to freeze it too.

    Args:
        policy: LeRobot's policy.

    Raises:
        CheckpointError: the checkpoint converts actions to those of ALOHA, or keeps no
            cache.
    """

    steps_option = "num_steps"

    def __init__(self, policy: Any) -> None:
        config = policy.config
        if config.adapt_to_pi_aloha:
            refuse(
                config.pretrained_path,
                "adapt_to_pi_aloha=true",
                "which changes batches in place",
            )
        if not config.use_cache:
            refuse(
                config.pretrained_path,
                "use_cache=false",
                "without which every denoising step would recompute images and text",
            )
        self.policy = policy
        self.model = policy.model
        self.hidden_size: int = self.model.action_out_proj.in_features
        self.summary_size: int = self.model.state_proj.out_features
        self.steps: int = getattr(config, self.steps_option)

    def prefix(self, batch: Batch) -> Prefix:
        """Pass images, text and state through SmolVLM, as LeRobot's sampling does."""
        images, image_masks = self.policy.prepare_images(batch)
        embedded, mask, attends = self.model.embed_prefix(
            images,
            image_masks,
            batch[OBS_LANGUAGE_TOKENS],
            batch[OBS_LANGUAGE_ATTENTION_MASK],
            state=self.policy.prepare_state(batch),
        )
        (hidden, _), cache = self.model.vlm_with_expert.forward(
            attention_mask=make_att_2d_masks(mask, attends),
            position_ids=torch.cumsum(mask, dim=1) - 1,
            past_key_values=None,
            inputs_embeds=[embedded, None],
            use_cache=True,
        )
        return Prefix.of(cache, mask, hidden)

    def prefix_modules(self) -> list[nn.Module]:
        """Return SmolVLM and the projection of the state."""
        return [self.model.vlm_with_expert.vlm, self.model.state_proj]

    def unused_modules(self) -> list[nn.Module]:
        """Return nothing."""
        return []

    def gradient_checkpointing(self) -> bool:
        """Return whether a language model in it recomputes its activations."""
        return any(
            getattr(module, "gradient_checkpointing", False)
            for module in self.model.modules()
        )


def build_smolvla(config: Any) -> Any:
    """Return LeRobot's policy with weights that a checkpoint is about to fill.

    With ``load_vlm_weights=true`` LeRobot would first read SmolVLM's own weights from
    the Hub, in bfloat16. The precision stays that, and the option, which is written
    back, as it was.
    """
    blank = copy.copy(config)
    blank.load_vlm_weights = False
    policy = get_policy_class(config.type)(blank)
    if config.load_vlm_weights:
        _to_bfloat16(policy.model.vlm_with_expert)
        policy.config.load_vlm_weights = True
    return policy


def _to_bfloat16(model: Any) -> None:
    """Give a model without weights the precision that SmolVLM's would bring along."""
    spared: set[int] = set()
    if "cross" in model.attention_mode:
        every = model.self_attn_every_n_layers
        for place, layer in enumerate(model.lm_expert.layers):
            # LeRobot puts projections of its own in here, in the default precision.
            if every < 1 or place % every:
                own = (layer.self_attn.k_proj, layer.self_attn.v_proj)
                spared |= {id(p) for module in own for p in module.parameters()}
    for parameter in model.parameters():
        if id(parameter) not in spared:
            parameter.data = parameter.data.to(torch.bfloat16)
