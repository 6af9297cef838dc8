"""OpenVLA out of transformers' own parts: DINOv2, SigLIP, a projector, and Llama."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.nn import functional
from transformers import (
    Dinov2WithRegistersConfig,
    Dinov2WithRegistersModel,
    DynamicCache,
    LlamaConfig,
    LlamaForCausalLM,
    SiglipVisionConfig,
    SiglipVisionModel,
)

from rlco.policies.vla.openvla.config import PIXELS, OpenVLAConfig


@dataclass
class Prompt:
    """Images and instructions after the language model has read them.

    Attributes:
        cache: Llama's keys and values.
        mask: which positions are not padding, bool, shape (B, P).
        state: the last position's features, which predict the first token, (B, W).
    """

    cache: DynamicCache
    mask: torch.Tensor
    state: torch.Tensor


class OpenVLA(nn.Module):
    """The model of openvla-7b (Kim et al., arXiv 2406.09246), natively.

    Patches of both image encoders are concatenated feature by feature, projected, and
    put between the first token of the prompt and the rest. The encoders end one block
    before their last, as OpenVLA reads them there. Prompts are filled up between
    patches and text: what predicts the first action is the last position in every row.

    Args:
        config: sizes.
    """

    means: torch.Tensor
    stds: torch.Tensor

    def __init__(self, config: OpenVLAConfig) -> None:
        super().__init__()
        self.config = config
        size = config.image_size
        self.dinov2 = Dinov2WithRegistersModel(
            Dinov2WithRegistersConfig(image_size=size, **config.dinov2)
        )
        self.siglip = SiglipVisionModel(
            SiglipVisionConfig(image_size=size, vision_use_head=False, **config.siglip)
        )
        # Neither is read, and the published checkpoint's are of no use.
        self.dinov2.layernorm = nn.Identity()
        self.siglip.vision_model.post_layernorm = nn.Identity()
        text = LlamaConfig(**config.text)
        patches = config.dinov2["hidden_size"] + config.siglip["hidden_size"]
        self.projector = nn.Sequential(
            nn.Linear(patches, 4 * patches),
            nn.GELU(),
            nn.Linear(4 * patches, text.hidden_size),
            nn.GELU(),
            nn.Linear(text.hidden_size, text.hidden_size),
        )
        self.language_model = LlamaForCausalLM(text)
        self.hidden_size: int = text.hidden_size
        means, stds = zip(*PIXELS, strict=True)
        self.register_buffer("means", torch.tensor(means), persistent=False)
        self.register_buffer("stds", torch.tensor(stds), persistent=False)

    @property
    def patches(self) -> int:
        """Patches of an image."""
        return int((self.config.image_size // self.config.dinov2["patch_size"]) ** 2)

    def see(self, images: torch.Tensor) -> torch.Tensor:
        """Return the projected patches (B, patches, W) of frames.

        Args:
            images: uint8, shape (B, 3, height, width).
        """
        size = (self.config.image_size, self.config.image_size)
        pixels = images.to(self.means.device).float() / 255
        if pixels.shape[-2:] != size:
            pixels = functional.interpolate(
                pixels, size, mode="bicubic", antialias=True, align_corners=False
            ).clamp(0, 1)
        dtype = self.projector[0].weight.dtype
        views = [
            ((pixels - mean[:, None, None]) / std[:, None, None]).to(dtype)
            for mean, std in zip(self.means, self.stds, strict=True)
        ]
        first = self.dinov2(views[0]).last_hidden_state
        # The class and the register tokens come before the patches.
        first = first[:, -self.patches :]
        second = self.siglip(views[1]).last_hidden_state
        projected: torch.Tensor = self.projector(torch.cat([first, second], -1))
        return projected

    def prompt(
        self, images: torch.Tensor, tokens: torch.Tensor, mask: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return embeddings (B, P, W) of images and text, and their mask (B, P).

        Args:
            images: uint8, shape (B, 3, height, width).
            tokens: the first, then padding, then the text, shape (B, L).
            mask: which of these are not padding, bool, shape (B, L).
        """
        patches = self.see(images)
        words = self.language_model.get_input_embeddings()(tokens)
        embedded = torch.cat([words[:, :1], patches, words[:, 1:]], 1)
        whole = torch.ones(patches.shape[:2], dtype=torch.bool, device=mask.device)
        return embedded, torch.cat([mask[:, :1], whole, mask[:, 1:]], 1)

    def read(
        self, images: torch.Tensor, tokens: torch.Tensor, mask: torch.Tensor
    ) -> Prompt:
        """Pass images and text through Llama, to draw actions afterwards."""
        embedded, whole = self.prompt(images, tokens, mask)
        cache = DynamicCache()
        hidden = self._llama(embedded, whole, 0, past_key_values=cache, use_cache=True)
        return Prompt(cache, whole, hidden[:, -1])

    def step(self, prompt: Prompt, token: torch.Tensor) -> torch.Tensor:
        """Add one action token (B,), in the whole vocabulary; return its state (B, W).

        The prompt's cache and mask grow by it.
        """
        embedded = self.language_model.get_input_embeddings()(token.unsqueeze(1))
        one = torch.ones_like(prompt.mask[:, :1])
        prompt.mask = torch.cat([prompt.mask, one], 1)
        hidden = self._llama(
            embedded,
            prompt.mask,
            prompt.mask.shape[1] - 1,
            past_key_values=prompt.cache,
            use_cache=True,
        )
        return hidden[:, -1]

    def states(
        self,
        images: torch.Tensor,
        tokens: torch.Tensor,
        mask: torch.Tensor,
        actions: torch.Tensor,
    ) -> torch.Tensor:
        """Return the states (B, n, W) that predict n given action tokens, in one pass.

        Args:
            images: uint8, shape (B, 3, height, width).
            tokens: as in ``prompt``.
            mask: as in ``prompt``.
            actions: tokens in the whole vocabulary, shape (B, n).
        """
        embedded, whole = self.prompt(images, tokens, mask)
        before = actions[:, :-1]
        words = self.language_model.get_input_embeddings()(before)
        hidden = self._llama(
            torch.cat([embedded, words], 1),
            torch.cat([whole, torch.ones_like(before, dtype=torch.bool)], 1),
            0,
            use_cache=False,
        )
        return hidden[:, -actions.shape[1] :]

    def action_logits(self, states: torch.Tensor) -> torch.Tensor:
        """Return logits (..., bins) over the action tokens alone, at least float32."""
        first, bins = self.config.first_action_token, self.config.bins
        every = self.language_model.lm_head(states)
        logits: torch.Tensor = every[..., first : first + bins]
        return logits.to(torch.promote_types(logits.dtype, torch.float32))

    def _llama(
        self, embedded: torch.Tensor, mask: torch.Tensor, start: int, **options: Any
    ) -> torch.Tensor:
        """Return Llama's last layer for positions from ``start`` on."""
        place = (mask.cumsum(1) - 1).clamp_min(0)[:, start:]
        hidden: torch.Tensor = self.language_model.model(
            inputs_embeds=embedded,
            attention_mask=mask.long(),
            position_ids=place,
            **options,
        ).last_hidden_state
        return hidden
