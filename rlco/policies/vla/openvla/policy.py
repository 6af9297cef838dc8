"""OpenVLA as an actor: tokens, their log-probabilities, imitation."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import InteractionType, TensorDictModuleBase
from tensordict.nn.probabilistic import interaction_type
from torch.distributions import Distribution
from torch.nn import functional
from torchrl.data.vla import VocabTailActionTokenizer

from rlco.errors import ConfigError, DataError
from rlco.keys import ACTION, CHUNK, IMAGE, INSTRUCTION_ID, LOG_PROB, SAMPLE
from rlco.policies.densities.path_distribution import (
    LogProbLevel,
    PathDistribution,
    check_level,
    per_level,
    stored_sample,
)
from rlco.policies.nets.encoder import Quantiles, read
from rlco.policies.vla.openvla.config import action_range
from rlco.policies.vla.openvla.inputs import prompt_tokens
from rlco.policies.vla.openvla.model import OpenVLA
from rlco.policies.vla.prefix_cache import SUMMARY


class OpenVLAPolicy(TensorDictModuleBase):
    """OpenVLA for PPO: each action number one token, drawn one after the other.

    One control step a decision, as OpenVLA has no chunks. Sampling caches keys and
    values; evaluating a stored sample is one pass over it. Logits outside the 256
    action tokens do not count.

    Called, it writes ``("vla_action", "sample")`` [B, 1, A], int64 tokens from 0 to
    255, ``("vla_action", "log_probs")``, ``("vla_action", "chunk")`` and ``action``
    [B, 1, A], raw, and ``("vla_prefix", "summary")`` [B, W], the state that predicts
    the first token, which critics read. Where TorchRL's exploration type asks for no
    sample, each token is the most likely one.

    Args:
        model: what :func:`rlco.policies.vla.openvla.load.load_openvla` returned.
        instructions: texts in the order of their ids.
        tokenizer: folder of Llama's tokenizer, openvla-7b's for instance.
        action_size: A.
        unnorm_key: whose statistics un-normalise the actions; None: the only ones.
        action_quantiles: 1 % and 99 % quantiles of the actions of your own data, each
            (A,), in place of the checkpoint's statistics.
        temperature: logits are divided by it, in sampling and in log-probabilities.
        log_prob_level: what one log-probability covers: "chunk" or "action" (here the
            same decision) or "token".
        action_limit: raw actions are clipped to it; None leaves them as they are.

    Raises:
        ConfigError: a number or a name that is not allowed.
        CheckpointError: no tokenizer, no statistics, or those of another action size.
    """

    kind: ClassVar[str] = "openvla"
    chunk: ClassVar[int] = 1
    tokens: torch.Tensor
    token_mask: torch.Tensor

    def __init__(
        self,
        model: OpenVLA,
        *,
        instructions: Sequence[str],
        tokenizer: str | os.PathLike[str],
        action_size: int = 7,
        unnorm_key: str | None = None,
        action_quantiles: Quantiles | None = None,
        temperature: float = 1.0,
        log_prob_level: LogProbLevel = "chunk",
        action_limit: float | None = 1.0,
    ) -> None:
        super().__init__()
        problems = check_level(log_prob_level)
        if not temperature > 0:
            problems.append(f"temperature={temperature} must be positive")
        if problems:
            raise ConfigError(problems)
        config = model.config
        stats = config.norm_stats
        if action_quantiles is not None:
            low, high = (torch.as_tensor(q).tolist() for q in action_quantiles)
            stats = {"given": {"action": {"q01": low, "q99": high}}}
            unnorm_key = "given"
        scale = action_range(stats, unnorm_key, action_size=action_size)
        self.model, self.action_size = model, action_size
        self.temperature, self.action_limit = temperature, action_limit
        self.log_prob_level: LogProbLevel = log_prob_level
        self.tokenizer = VocabTailActionTokenizer(
            config.bins,
            norm_low=torch.tensor(scale.low),
            norm_high=torch.tensor(scale.high),
            norm_mask=torch.tensor(scale.mask),
        )
        tokens, mask = prompt_tokens(config, instructions, tokenizer)
        self.register_buffer("tokens", tokens, persistent=False)
        self.register_buffer("token_mask", mask, persistent=False)
        self.in_keys: list[Any] = [IMAGE, INSTRUCTION_ID]
        self.dist_sample_keys: list[Any] = [SAMPLE]
        self.log_prob_keys: list[Any] = [LOG_PROB]
        self.replay_keys: list[Any] = [SAMPLE, *self.in_keys]
        self.out_keys = [SAMPLE, LOG_PROB, CHUNK, ACTION, SUMMARY]
        self.to(self.device)

    @property
    def device(self) -> torch.device:
        """Where the model computes."""
        return self.model.means.device

    def _inputs(
        self, tensordict: TensorDictBase
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return images, tokens and mask of a batch (B,)."""
        ids = read(tensordict, INSTRUCTION_ID).to(self.device)
        if bool((ids < 0).any() | (ids >= len(self.tokens)).any()):
            raise DataError(
                f"instruction ids go from {int(ids.min())} to {int(ids.max())}, but "
                f"the policy knows {len(self.tokens)} instructions; give all of them."
            )
        images = read(tensordict, IMAGE).to(self.device)
        return images, self.tokens[ids], self.token_mask[ids]

    @torch.no_grad()
    def new_summary(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return what critics read [B, W] of the observations of a batch (B,)."""
        return self.model.read(*self._inputs(tensordict)).state.float()

    def _logits(self, states: torch.Tensor) -> torch.Tensor:
        return self.model.action_logits(states) / self.temperature

    def _evaluate(
        self, tensordict: TensorDictBase, sample: torch.Tensor
    ) -> torch.Tensor:
        """Return log-probabilities [B, 1, A, bins] of tokens given those before."""
        inputs = self._inputs(tensordict)
        ids = sample.flatten(1).to(self.device) + self.model.config.first_action_token
        logits = self._logits(self.model.states(*inputs, ids))
        log_probs = functional.log_softmax(logits, -1)
        return log_probs.view(*sample.shape, -1)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write sample, log-probability, chunk, action and summary.

        All of it lies where the observations do.
        """
        home = read(tensordict, IMAGE).device
        prompt = self.model.read(*self._inputs(tensordict))
        tensordict.set(SUMMARY, prompt.state.float().to(home))
        state, first = prompt.state, self.model.config.first_action_token
        explores = interaction_type() in (None, InteractionType.RANDOM)
        drawn: list[torch.Tensor] = []
        log_probs: list[torch.Tensor] = []
        for number in range(self.action_size):
            if number:
                state = self.model.step(prompt, drawn[-1] + first)
            log_softmax = functional.log_softmax(self._logits(state), -1)
            if explores:
                token = torch.multinomial(log_softmax.exp(), 1).squeeze(-1)
            else:
                token = log_softmax.argmax(-1)
            drawn.append(token)
            log_probs.append(log_softmax.gather(-1, token.unsqueeze(-1)).squeeze(-1))
        sample = torch.stack(drawn, -1).unsqueeze(1)
        each = torch.stack(log_probs, -1).unsqueeze(1)
        tensordict.set(SAMPLE, sample.to(home))
        tensordict.set(LOG_PROB, per_level(each, self.log_prob_level).to(home))
        raw = self.tokenizer.decode(sample).float().to(home)
        if self.action_limit is not None:
            raw = raw.clamp(-self.action_limit, self.action_limit)
        tensordict.set(CHUNK, raw)
        tensordict.set(ACTION, raw)
        return tensordict

    def get_dist(self, tensordict: TensorDictBase) -> Distribution:
        """Return the density of the batch's own tokens, [B] or finer.

        Raises:
            DataError: the batch holds no sample.
        """
        sample = stored_sample(tensordict)
        log_probs = self._evaluate(tensordict, sample)
        index = sample.to(log_probs.device).unsqueeze(-1)
        chosen = log_probs.gather(-1, index).squeeze(-1)
        entropy = -(log_probs.exp() * log_probs).sum(-1)
        level = self.log_prob_level
        return PathDistribution(
            sample,
            per_level(chosen, level).to(sample.device),
            per_level(entropy, level).to(sample.device),
        )

    def imitation_loss(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return the cross-entropy [B, 1], the mean over action dimensions [nats].

        Args:
            tensordict: images, instruction ids and ``("vla_action", "chunk")``
                [B, 1, A], raw.

        Raises:
            DataError: the chunk is missing or of another shape.
        """
        chunk = read(tensordict, CHUNK)
        shape = (*tensordict.batch_size, 1, self.action_size)
        if chunk.shape != shape:
            raise DataError(
                f"demonstrated chunks have shape {tuple(chunk.shape)}, OpenVLA's are "
                f"{shape}; load the data with chunk=1."
            )
        sample = self.tokenizer.encode(chunk.to(self.device))
        log_probs = self._evaluate(tensordict, sample)
        chosen = log_probs.gather(-1, sample.unsqueeze(-1)).squeeze(-1)
        return -chosen.mean(-1)
