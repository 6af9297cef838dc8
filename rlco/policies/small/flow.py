"""pi0.5's kind of policy, small: action chunks out of noise, by a learned flow."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch.distributions import Distribution

from rlco.errors import ConfigError
from rlco.keys import DENOISE_STEP, FLOW_NOISE, FLOW_TIME, LOG_PROB, SAMPLE
from rlco.physics.spec.actions import LIMIT
from rlco.policies.densities.flow_chain import (
    DenoiseReduction,
    FlowChain,
    FlowMethod,
    NoisySteps,
    Velocity,
)
from rlco.policies.densities.flow_matching import draw_times, squared_error
from rlco.policies.densities.path_distribution import (
    LogProbLevel,
    PathDistribution,
    check_level,
    per_level,
    stored_sample,
)
from rlco.policies.nets.encoder import read
from rlco.policies.nets.flow_network import FlowNetwork
from rlco.policies.nets.image_encoder import ImageArguments
from rlco.policies.small.chunk_policy import ChunkPolicy


class FlowPolicy(ChunkPolicy):
    """Chunks by flow matching, with log-probabilities that PPO can use.

    The recipe of pi0.5 (arXiv 2504.16054) and of its reinforcement learning in piRL
    (arXiv 2510.25889), on numbers instead of images and text: a perceptron turns the
    observation into a context, another the context, the time and a noisy chunk into a
    velocity, which K Euler steps follow from noise to a chunk. A flow has no density
    that could be computed; ``method`` says what stands for it:

    - "flow_noise": every step adds noise of a learned size (ReinFlow, arXiv
      2505.22094); the density is that of the whole chain. The choice of RL-Co.
    - "flow_sde": every step is one of a stochastic flow with the same marginals.
    - "fpo": steps stay deterministic; the ratio is the exponential of how much the
      flow-matching loss of the sampled chunk falls, at ``fpo_draws`` stored times and
      noises (arXiv 2507.21053). FPO cuts the logarithm of the ratio at 3 and clips at
      0.05: ``ClipPPOLoss(clip_epsilon=0.05, max_importance_ratio=20)``.

    Called, it writes ``("vla_action", "sample")``, the chain [B, K + 1, H, A],
    ``("vla_action", "log_probs")``, ``("vla_action", "chunk")`` and ``action``
    [B, H, A], raw, and what else of ``replay_keys`` the method needs. Where TorchRL's
    exploration type asks for no sample, it starts from zeros instead of noise and adds
    none: the same observation gives the same action. No gradient flows through that;
    ``get_dist(td)``, for a batch that holds the sample, is differentiable.

    Args:
        state_size: dimension of the state.
        chunk: steps H of a chunk.
        action_size: action dimensions A.
        environment_state_size: dimension of the environment state; 0: not read.
        num_instructions: instructions to tell apart; 0: not read.
        image: how images are read, see `rlco.policies.ImageArguments`; None: not.
        action_limit: raw actions are clipped to it; None leaves them as they are.
        guidance: weight of guidance by a domain flag; None: it reads none.
        hidden: width of each hidden layer.
        steps: denoising steps K.
        method: "flow_noise", "flow_sde" or "fpo".
        noisy_steps: "all", or "one": a single step of each decision, drawn anew, is
            noisy and counts; the update then costs one K-th.
        noise_range: least and greatest standard deviation of Flow-Noise's steps.
        noise_level: a of Flow-SDE.
        denoise_reduction: "mean" of a chain's K + 1 terms, as in RLinf, or their
            "sum", the density of the chain. The mean tempers all ratios.
        log_prob_level: what one log-probability covers: "chunk" [B], "action" [B, H]
            or "token" [B, H, A].
        fpo_draws: times and noises that FPO compares losses at.
        imitation_draws: times and noises that imitation draws for each row.
        padded_size: None: the imitation loss of a step is the mean over its A
            numbers. A number: as in RLinf, the mean over so many, of which A are real
            and the others nothing to learn; the same beta then pulls A / padded_size
            times as hard.

    Raises:
        ConfigError: numbers that are not positive, or a name that is not known.
        CheckpointError: the image encoder's weights cannot be loaded.

    Example:
        >>> from tensordict import TensorDict
        >>> policy = FlowPolicy(3, chunk=4, hidden=(16,))
        >>> td = policy(TensorDict({"observation": {"state": torch.zeros(5, 3)}}, [5]))
        >>> td["action"].shape, td["vla_action", "sample"].shape
        (torch.Size([5, 4, 7]), torch.Size([5, 5, 4, 7]))
        >>> dist = policy.get_dist(td)
        >>> dist.log_prob(td["vla_action", "sample"]).shape
        torch.Size([5])
    """

    kind: ClassVar[str] = "flow"

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
        steps: int = 4,
        method: FlowMethod = "flow_noise",
        noisy_steps: NoisySteps = "all",
        noise_range: Sequence[float] = (0.08, 0.16),
        noise_level: float = 0.5,
        denoise_reduction: DenoiseReduction = "mean",
        log_prob_level: LogProbLevel = "chunk",
        fpo_draws: int = 8,
        imitation_draws: int = 1,
        padded_size: int | None = None,
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
        self.chain = FlowChain(
            method, steps, noisy_steps, noise_level, denoise_reduction
        )
        options: dict[str, Any] = {
            "hidden": list(hidden),
            "steps": steps,
            "method": method,
            "noisy_steps": noisy_steps,
            "noise_range": list(noise_range),
            "noise_level": noise_level,
            "denoise_reduction": denoise_reduction,
            "log_prob_level": log_prob_level,
            "fpo_draws": fpo_draws,
            "imitation_draws": imitation_draws,
            "padded_size": padded_size,
        }
        problems = [*self.chain.problems(), *check_level(log_prob_level)]
        problems += _problems(options, action_size)
        if problems:
            raise ConfigError(problems)
        self.arguments |= options
        self.log_prob_level, self.fpo_draws = log_prob_level, fpo_draws
        self.imitation_draws = imitation_draws
        self.weight = action_size / (padded_size or action_size)
        low, high = noise_range
        self.network = FlowNetwork(
            self.feature_size,
            (chunk, action_size),
            hidden=hidden,
            noise_range=(low, high),
        )
        extra: list[Any] = []
        if method == "fpo":
            extra = [FLOW_TIME, FLOW_NOISE]
        elif noisy_steps == "one":
            extra = [DENOISE_STEP]
        self.replay_keys += extra
        self.out_keys += extra

    def get_dist(self, tensordict: TensorDictBase) -> Distribution:
        """Return the density of the batch's own sample, [B] or finer.

        With FPO the "density" is minus the flow-matching loss of the sampled chunk,
        the mean over its numbers: the ratio of two of them is FPO's.

        Raises:
            DataError: the batch lacks one of ``replay_keys``.
        """
        return self._density(tensordict, self._guided(self._contexts(tensordict)))

    def _density(self, tensordict: TensorDictBase, velocity: Velocity) -> Distribution:
        """Return the density of the batch's own sample, given the velocity."""
        path, level = stored_sample(tensordict), self.log_prob_level
        if self.chain.method == "fpo":
            elements = -squared_error(
                velocity,
                path[..., -1, :, :],
                read(tensordict, FLOW_TIME),
                read(tensordict, FLOW_NOISE),
            ).mean(-3)
            total = per_level(elements, level)
            return PathDistribution(
                path, total * total.numel() / elements.numel(), None
            )
        one = self.chain.noisy_steps == "one"
        noisy = read(tensordict, DENOISE_STEP) if one else None
        log_prob, entropy = self.chain.density(
            velocity, self.network.noise_std, path, noisy
        )
        return PathDistribution(
            path, per_level(log_prob, level), per_level(entropy, level)
        )

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write sample, log-probability, chunk and action into ``tensordict``."""
        self.store_images(tensordict)
        contexts = self._contexts(tensordict)
        velocity = self._guided(contexts)
        batch, explores = contexts[0].shape[:-1], self.explores
        noise = contexts[0].new_zeros(*batch, self.chunk, self.action_size)
        if explores:
            noise.normal_()
        noisy = self._prepare(tensordict, noise)
        chain = self.chain.draw(
            velocity,
            self.network.noise_std,
            noise,
            noisy if explores else None,
        )
        tensordict.set(SAMPLE, chain)
        density = self._density(tensordict, velocity)  # the image is read once
        tensordict.set(LOG_PROB, density.log_prob(chain))
        self.act(tensordict, chain[..., -1, :, :])
        return tensordict

    def _prepare(
        self, tensordict: TensorDictBase, like: torch.Tensor
    ) -> torch.Tensor | None:
        """Write what the replay needs beside the chain; return the noisy steps [B]."""
        batch = like.shape[:-2]
        if self.chain.method == "fpo":
            time, noise = self._draw(like, self.fpo_draws)
            tensordict.set(FLOW_TIME, time)
            tensordict.set(FLOW_NOISE, noise)
            return None
        if self.chain.noisy_steps == "all":
            return torch.full(batch, -1, device=like.device)
        step = torch.randint(self.chain.steps, batch, device=like.device)
        tensordict.set(DENOISE_STEP, step)
        return step

    def imitation_loss(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return each step's error of the velocity [B, H], at random times and noises.

        Args:
            tensordict: observations and ``("vla_action", "chunk")`` [B, H, A], raw.

        Raises:
            DataError: the chunk is missing or of another shape than the policy's.
        """
        target = self.demonstrated(tensordict)
        time, noise = self._draw(target, self.imitation_draws)
        context = self.network.observe(self.features(tensordict))
        error = squared_error(partial(self.network, context), target, time, noise)
        return error.mean((-3, -1)) * self.weight

    def _contexts(self, tensordict: TensorDictBase) -> list[torch.Tensor]:
        """Return the features that the velocity acts by [B, width]."""
        return list(map(self.network.observe, self.acting_features(tensordict)))

    def _guided(self, contexts: list[torch.Tensor]) -> Velocity:
        """Return the guided velocity; the noise of steps is that with the flag."""

        def velocity(
            x: torch.Tensor, time: torch.Tensor
        ) -> tuple[torch.Tensor, torch.Tensor]:
            found = [self.network(context, x, time) for context in contexts]
            return self.guided(v for v, _ in found), found[0][1]

        return velocity

    @staticmethod
    def _draw(like: torch.Tensor, draws: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return times [B, D] and noises [B, D, H, A] for chunks [B, H, A]."""
        *batch, steps, size = like.shape
        noise = like.new_empty(*batch, draws, steps, size).normal_()
        return draw_times((*batch, draws), like), noise


def _problems(options: dict[str, Any], action_size: int) -> list[str]:
    problems = []
    ends = options["noise_range"]
    if len(ends) != 2 or not 0 < ends[0] <= ends[1]:
        problems.append(f"noise_range={ends} must be two positive numbers in order")
    if not options["hidden"]:
        problems.append("hidden=[] must name at least one layer")
    problems += [
        f"{name}={options[name]} must be at least 1"
        for name in ("fpo_draws", "imitation_draws")
        if options[name] < 1
    ]
    padded = options["padded_size"]
    if padded is not None and padded < action_size:
        problems.append(f"padded_size={padded} must be at least {action_size}")
    return problems
