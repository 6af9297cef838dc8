"""OpenVLA's kind of policy, small: actions as tokens, drawn one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch.distributions import Distribution
from torch.nn import functional

from rlco.errors import ConfigError, RlcoError
from rlco.keys import LOG_PROB, SAMPLE
from rlco.physics.spec.actions import LIMIT
from rlco.policies.densities.action_tokens import ActionTokens
from rlco.policies.densities.path_distribution import (
    LogProbLevel,
    PathDistribution,
    check_level,
    per_level,
    stored_sample,
)
from rlco.policies.nets.causal_transformer import CausalTransformer
from rlco.policies.nets.image_encoder import ImageArguments
from rlco.policies.nets.mlp import Mlp
from rlco.policies.small.chunk_policy import ChunkPolicy


class TokenPolicy(ChunkPolicy):
    """Every action number of a chunk as one of 256 tokens, autoregressively.

    The recipe of OpenVLA (Kim et al., arXiv 2406.09246), on numbers instead of
    images and text: a perceptron turns the observation into a context, a causal
    transformer predicts token after token, first the numbers of the first step, then
    those of the next. Sampling caches keys and values; evaluating a stored sample is
    one pass over it.

    Called, it writes ``("vla_action", "sample")`` [B, H, A], int64 tokens,
    ``("vla_action", "log_probs")``, ``("vla_action", "chunk")`` and ``action``
    [B, H, A], raw. Where TorchRL's exploration type asks for no sample, each token is
    the most likely one. No gradient flows through that; ``get_dist(td)``, for a batch
    that holds the sample, is differentiable.

    Args:
        state_size: dimension of the state.
        chunk: steps H of a chunk.
        action_size: action dimensions A.
        environment_state_size: dimension of the environment state; 0: not read.
        num_instructions: instructions to tell apart; 0: not read.
        image: how images are read, see `rlco.policies.ImageArguments`; None: not.
        action_limit: raw actions are clipped to it; None leaves them as they are.
        guidance: weight of guidance by a domain flag; None: it reads none.
        hidden: width of each hidden layer of the perceptron.
        width: features of a position of the transformer.
        layers: its blocks.
        heads: its attention heads.
        bins: tokens a number.
        bin_range: the outermost edges in the normalised action space. 1, OpenVLA's,
            clips to the 1 % and 99 % quantiles of the demonstrations.
        temperature: logits are divided by it, in sampling and in log-probabilities.
        log_prob_level: what one log-probability covers: "chunk" [B], the sum of all;
            "action" [B, H], a control step's; "token" [B, H, A].
        noise_std: standard deviation of noise that imitation puts on the demonstrated
            numbers, in the normalised action space; 0 is the plain cross-entropy.
            With it the labels are blurred, so that neighbouring tokens mean
            neighbouring actions, and the tokens before them are drawn with the same
            noise, so that the network trusts them no more than those it will draw
            itself. It is also how much reinforcement learning explores.
        hidden_share: share of demonstrated chunks whose tokens imitation shows to none
            of their successors, which must then tell from the observation alone.
            Otherwise a number's best sign is the same number a step earlier: the
            network copies it and hardly looks.

    Raises:
        ConfigError: sizes that are not positive, or a name that is not known.
        CheckpointError: the image encoder's weights cannot be loaded.

    Example:
        >>> from tensordict import TensorDict
        >>> policy = TokenPolicy(3, chunk=4, hidden=(16,), width=16)
        >>> td = policy(TensorDict({"observation": {"state": torch.zeros(5, 3)}}, [5]))
        >>> td["action"].shape, td["vla_action", "sample"].dtype
        (torch.Size([5, 4, 7]), torch.int64)
        >>> dist = policy.get_dist(td)
        >>> dist.log_prob(td["vla_action", "sample"]).shape
        torch.Size([5])
    """

    kind: ClassVar[str] = "token"

    def __init__(
        self,
        state_size: int,
        *,
        chunk: int,
        action_size: int = 7,
        environment_state_size: int = 0,
        num_instructions: int = 0,
        image: ImageArguments | None = None,
        action_limit: float | None = LIMIT,
        guidance: float | None = None,
        hidden: Sequence[int] = (256, 256),
        width: int = 64,
        layers: int = 1,
        heads: int = 4,
        bins: int = 256,
        bin_range: float = 1.25,
        temperature: float = 1.0,
        log_prob_level: LogProbLevel = "chunk",
        noise_std: float = 0.2,
        hidden_share: float = 0.5,
    ) -> None:
        super().__init__(
            state_size,
            chunk=chunk,
            action_size=action_size,
            environment_state_size=environment_state_size,
            num_instructions=num_instructions,
            image=image,
            action_limit=action_limit,
            guidance=guidance,
        )
        problems = check_level(log_prob_level)
        if not temperature > 0:
            problems.append(f"temperature={temperature} must be positive")
        if not 0 <= hidden_share <= 1:
            problems.append(f"hidden_share={hidden_share} must be within 0 and 1")
        if not hidden:
            problems.append("hidden=[] must name at least one layer")
        if problems:
            raise ConfigError(problems)
        self.arguments |= {
            "hidden": list(hidden),
            "width": width,
            "layers": layers,
            "heads": heads,
            "bins": bins,
            "bin_range": bin_range,
            "temperature": temperature,
            "log_prob_level": log_prob_level,
            "noise_std": noise_std,
            "hidden_share": hidden_share,
        }
        self.temperature, self.log_prob_level = temperature, log_prob_level
        self.noise_std, self.hidden_share = noise_std, hidden_share
        self.tokens = ActionTokens(bins, bin_range, noise_std)
        *trunk, context = hidden
        self.observe = Mlp(self.feature_size, context, hidden=trunk or hidden)
        self.network = CausalTransformer(
            bins,
            chunk * action_size,
            width=width,
            layers=layers,
            heads=heads,
            context=context,
        )

    def get_dist(self, tensordict: TensorDictBase) -> Distribution:
        """Return the density of the batch's own sample, [B] or finer.

        Raises:
            DataError: the batch holds no sample.
        """
        path = stored_sample(tensordict)
        acting = self.acting_features(tensordict)
        logits = self.guided(self._evaluate(one, path)[0] for one in acting)
        log_probs = functional.log_softmax(logits, -1)
        chosen = log_probs.gather(-1, path.unsqueeze(-1)).squeeze(-1)
        level = self.log_prob_level

        def entropy() -> torch.Tensor:
            return per_level(-(log_probs.exp() * log_probs).sum(-1), level)

        return PathDistribution(path, per_level(chosen, level), entropy)

    def first_state(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return the features [B, width] that predict the first token.

        They know the observation and no token: what a value head reads.
        """
        context = self.observe(self.features(tensordict))
        flat = context.flatten(0, -2)
        start = torch.zeros(len(flat), 1, dtype=torch.int64, device=flat.device)
        first: torch.Tensor = self.network(flat, start)[1]
        return first.view(*context.shape[:-1], -1)

    def _evaluate(
        self,
        features: torch.Tensor,
        tokens: torch.Tensor,
        hidden: torch.Tensor | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return tempered logits [B, H, A, bins] of tokens [B, H, A], in one pass."""
        context = self.observe(features).flatten(0, -2)
        flat = tokens.reshape(len(context), -1)
        logits, first = self.network(context, flat, hidden)
        return logits.view(*tokens.shape, -1) / self.temperature, first

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write sample, log-probability, chunk and action into ``tensordict``.

        Raises:
            RlcoError: probabilities are not finite.
        """
        self.store_images(tensordict)
        contexts = list(map(self.observe, self.acting_features(tensordict)))
        tokens, log_probs = self._draw([one.flatten(0, -2) for one in contexts])
        shape = (*contexts[0].shape[:-1], self.chunk, self.action_size)
        sample = tokens.view(shape)
        tensordict.set(SAMPLE, sample)
        tensordict.set(LOG_PROB, per_level(log_probs.view(shape), self.log_prob_level))
        self.act(tensordict, self.tokens.decode(sample))
        return tensordict

    def _draw(
        self, contexts: Sequence[torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return tokens [N, P] and their log-probabilities, one after the other."""
        cached = [(one, self.network.start(one)) for one in contexts]
        last = None
        tokens, log_probs = [], []
        for position in range(self.chunk * self.action_size):
            logits = self.guided(
                self.network.step(context, last, position, caches)
                for context, caches in cached
            )
            log_softmax = functional.log_softmax(logits / self.temperature, -1)
            if self.explores:
                last = _drawn(log_softmax.exp())
            else:
                last = log_softmax.argmax(-1)
            tokens.append(last)
            log_probs.append(log_softmax.gather(-1, last.unsqueeze(-1)).squeeze(-1))
        chosen = torch.stack(log_probs, -1)
        if not chosen.isfinite().all():
            raise RlcoError(
                "the policy's token probabilities are not numbers any more: its "
                "training diverged; go on from an earlier checkpoint with a lower "
                "learning rate"
            )
        return torch.stack(tokens, -1), chosen

    def imitation_loss(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return each step's cross-entropy [B, H], the mean over its numbers [nats].

        Args:
            tensordict: observations and ``("vla_action", "chunk")`` [B, H, A], raw.

        Raises:
            DataError: the chunk is missing or of another shape than the policy's.
        """
        target = self.demonstrated(tensordict)
        before = target
        if self.noise_std:
            before = target + self.noise_std * torch.randn_like(target)
        hidden = None
        if self.hidden_share:
            rows = target.shape[:-2].numel()
            hidden = torch.rand(rows, device=target.device) < self.hidden_share
        features, tokens = self.features(tensordict), self.tokens.encode(before)
        logits, _ = self._evaluate(features, tokens, hidden)
        labels = self.tokens.labels[self.tokens.encode(target)]
        return -(labels * functional.log_softmax(logits, -1)).sum(-1).mean(-1)


def _drawn(chances: torch.Tensor) -> torch.Tensor:
    """Return a token [N] of each row of chances [N, bins].

    One random number a row: `torch.multinomial` draws one for each bin, which took a
    third of the time of sampling.
    """
    below = chances.cumsum(-1)
    uniform = torch.rand_like(below[:, :1]) * below[:, -1:]
    found = torch.searchsorted(below, uniform, right=True).squeeze(-1)
    return found.clamp_max(chances.shape[-1] - 1)
