"""pi0.5 and SmolVLA as actors: chains, log-probabilities, imitation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import InteractionType, TensorDictModuleBase
from tensordict.nn.probabilistic import interaction_type
from torch.distributions import Distribution
from torch.nn import functional

from rlco.errors import ConfigError, DataError
from rlco.keys import (
    ACTION,
    CHUNK,
    DENOISE_STEP,
    IMAGE,
    INSTRUCTION_ID,
    LOG_PROB,
    SAMPLE,
    STATE,
)
from rlco.policies.densities.flow_chain import DenoiseReduction, FlowChain, NoisySteps
from rlco.policies.densities.flow_matching import squared_error
from rlco.policies.densities.path_distribution import (
    LogProbLevel,
    PathDistribution,
    check_level,
    per_level,
    stored_sample,
)
from rlco.policies.nets.encoder import read
from rlco.policies.vla.lerobot.checkpoint import LeRobotCheckpoint
from rlco.policies.vla.lerobot.flow_model import check_trainable, velocity_given
from rlco.policies.vla.lerobot.inputs import LeRobotInputs
from rlco.policies.vla.lerobot.noise import StepNoise, check_range
from rlco.policies.vla.lerobot.trained_weights import Trained, freeze
from rlco.policies.vla.prefix_cache import PREFIX_KEYS, SUMMARY, Prefix

_Method = Literal["flow_noise", "flow_sde"]


class LeRobotPolicy(TensorDictModuleBase):
    """A LeRobot checkpoint of pi0.5 or SmolVLA as an actor that PPO can train.

    LeRobot's classes are used as they are. Images and text go through its processors
    and its vision-language model, the prefix; the action expert then follows a flow
    from noise to a chunk in K steps. Log-probabilities are those of the whole chain,
    by Flow-Noise or Flow-SDE, over the executed steps and the action dimensions without
    padding; chains hold the padded ones too.

    With the prefix frozen (``trained="expert"``), its keys and values are written into
    the rollout and read from it in every update: what an update then costs is the
    expert alone. Gradients and log-probabilities stay the same.

    Called, it writes ``("vla_action", "sample")``, the chain [B, K + 1, H, width],
    ``("vla_action", "log_probs")``, ``("vla_action", "chunk")`` and ``action``
    [B, executed, A], raw, and the prefix, whose ``summary`` critics read. Where
    TorchRL's exploration type asks for no sample, the steps add no noise; the chain
    still starts from noise, as in LeRobot's own commands, and of the prefix there is
    the summary alone, as nothing is learned from that. No gradient flows through
    that; ``get_dist(td)``, for a batch that holds the sample, is differentiable.

    ``executed`` and ``steps`` become those of the checkpoint's configuration: what
    LeRobot's commands make of a saved checkpoint is what was trained.

    Args:
        checkpoint: what `rlco.policies.vla.lerobot.checkpoint.load_lerobot` returned.
        instructions: texts in the order of their ids.
        camera: the checkpoint's camera that rlco's images show; None: its only one.
        executed: steps of a chunk that are executed; None: the checkpoint's own.
        trained: "expert" freezes the prefix, "full" leaves every weight as LeRobot's
            configuration has it.
        method: "flow_noise", steps with noise of a learned size, or "flow_sde".
        steps: denoising steps K; None: the checkpoint's own.
        noisy_steps: "all", or "one" of each decision, drawn anew.
        noise_range: least and greatest standard deviation of Flow-Noise's steps.
        noise_level: a of Flow-SDE.
        denoise_reduction: "mean" of a chain's K + 1 terms, as in RLinf, or their "sum".
        log_prob_level: what one log-probability covers: "chunk" [B], "action"
            [B, executed] or "token" [B, executed, A].
        padded_mean: whether the imitation loss is the mean over all numbers that the
            model has, padding included, as in RLinf, instead of the real ones: beta
            there and here differ by that.
        keep_prefix: whether a rollout carries the frozen prefix.
        action_limit: raw actions are clipped to it; None leaves them as they are.

    Raises:
        ConfigError: a number or a name that is not allowed.
    """

    kind: ClassVar[str] = "lerobot"

    def __init__(
        self,
        checkpoint: LeRobotCheckpoint,
        *,
        instructions: Sequence[str],
        camera: str | None = None,
        executed: int | None = None,
        trained: Trained = "expert",
        method: _Method = "flow_noise",
        steps: int | None = None,
        noisy_steps: NoisySteps = "all",
        noise_range: tuple[float, float] = (0.08, 0.16),
        noise_level: float = 0.5,
        denoise_reduction: DenoiseReduction = "mean",
        log_prob_level: LogProbLevel = "chunk",
        padded_mean: bool = False,
        keep_prefix: bool = True,
        action_limit: float | None = 1.0,
    ) -> None:
        super().__init__()
        config = checkpoint.config
        self.model = checkpoint.model
        self.policy = self.model.policy
        self.chunk: int = config.chunk_size
        self.executed: int = config.n_action_steps if executed is None else executed
        self.action_size: int = config.action_feature.shape[0]
        self.width: int = config.max_action_dim
        steps = self.model.steps if steps is None else steps
        self.chain = FlowChain(
            method, steps, noisy_steps, noise_level, denoise_reduction
        )
        problems = self.chain.problems() + check_level(log_prob_level)
        problems += check_range(noise_range)
        if trained not in get_args(Trained):
            problems.append(f"unknown trained {trained!r}; known: 'expert', 'full'")
        if not 1 <= self.executed <= self.chunk:
            problems.append(
                f"executed={self.executed} must be 1 to {self.chunk}, the steps that "
                "the checkpoint predicts"
            )
        if problems:
            raise ConfigError(problems)
        self.inputs = LeRobotInputs(
            config,
            checkpoint.preprocessor,
            checkpoint.postprocessor,
            instructions=instructions,
            camera=camera,
        )
        self.noise = StepNoise(self.model.hidden_size, self.width, noise_range)
        self.noise.to(next(self.policy.parameters()).device)
        self.log_prob_level: LogProbLevel = log_prob_level
        self.padded_mean, self.action_limit = padded_mean, action_limit
        freeze(self.model, trained)
        config.n_action_steps = self.executed
        setattr(config, self.model.steps_option, steps)
        self.keep_prefix = keep_prefix and not self.trains_prefix
        self.in_keys: list[Any] = [STATE, IMAGE, INSTRUCTION_ID]
        self.dist_sample_keys: list[Any] = [SAMPLE]
        self.log_prob_keys: list[Any] = [LOG_PROB]
        extra = [DENOISE_STEP] if noisy_steps == "one" else []
        read = PREFIX_KEYS if self.keep_prefix else self.in_keys
        #: What a rollout has to keep to recompute log-probabilities.
        self.replay_keys: list[Any] = [SAMPLE, *extra, *read]
        written = PREFIX_KEYS if self.keep_prefix else [SUMMARY]
        self.out_keys = [SAMPLE, LOG_PROB, CHUNK, ACTION, *extra, *written]

    @property
    def trains_prefix(self) -> bool:
        """Whether any weight that images and text pass through is trained."""
        return any(
            parameter.requires_grad
            for module in self.model.prefix_modules()
            for parameter in module.parameters()
        )

    @property
    def device(self) -> torch.device:
        """Where the model computes."""
        weight: torch.Tensor = self.policy.model.action_out_proj.weight
        return weight.device

    # -- The prefix --------------------------------------------------------------

    def prefix(self, tensordict: TensorDictBase) -> Prefix:
        """Return the prefix of a batch (B,): the one that it carries, or a new one.

        Raises:
            ConfigError: gradient checkpointing is on, or the batch carries a prefix
                although the weights behind it are trained.
            DataError: an observation is missing.
        """
        check_trainable(self.model)
        carried = Prefix.read(tensordict)
        if carried is None:
            return self.new_prefix(tensordict)
        if self.trains_prefix:
            raise ConfigError(
                [
                    "the batch carries prefixes of weights that are trained; build the "
                    "policy with keep_prefix=False, or trained='expert'"
                ]
            )
        return carried.to(self.device)

    def new_prefix(self, tensordict: TensorDictBase) -> Prefix:
        """Pass the observations of a batch (B,) through the language model."""
        check_trainable(self.model)
        gradient = torch.is_grad_enabled() and self.trains_prefix
        with torch.set_grad_enabled(gradient):
            return self.model.prefix(self.inputs.observe(tensordict))

    @torch.no_grad()
    def new_summary(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return what critics read [B, W] of the observations of a batch (B,)."""
        return self.new_prefix(tensordict).summary

    # -- The actor's three answers -------------------------------------------------

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write sample, log-probability, chunk, action and prefix.

        All of it lies where the observations do, not in an accelerator's memory.
        """
        home = read(tensordict, STATE).device
        # Collectors hand back what was written one decision before.
        prefix = self.new_prefix(tensordict)
        shape = (tensordict.batch_size.numel(), self.chunk, self.width)
        noise = torch.randn(shape, device=self.device)
        noisy = self._draw_noisy(len(noise))
        velocity = velocity_given(self.model, prefix)
        explores = interaction_type() in (None, InteractionType.RANDOM)
        chain = self.chain.draw(
            velocity, self.noise, noise, noisy if explores else None
        )
        counted = noisy if self.chain.noisy_steps == "one" else None
        density = self.chain.density(velocity, self.noise, chain, counted)
        tensordict.set(SAMPLE, chain.to(home))
        tensordict.set(LOG_PROB, self._per_level(density[0]).to(home))
        if counted is not None:
            tensordict.set(DENOISE_STEP, counted.to(home))
        if self.keep_prefix and explores:
            prefix.to(home).write(tensordict)
        else:
            prefix.write_summary(tensordict, home)
        raw = self.inputs.unnormalize(chain[:, -1, :, : self.action_size]).to(home)
        if self.action_limit is not None:
            raw = raw.clamp(-self.action_limit, self.action_limit)
        tensordict.set(CHUNK, raw[:, : self.executed])
        tensordict.set(ACTION, raw[:, : self.executed])
        return tensordict

    def _draw_noisy(self, rows: int) -> torch.Tensor:
        if self.chain.noisy_steps == "one":
            return torch.randint(self.chain.steps, (rows,), device=self.device)
        return torch.full((rows,), -1, device=self.device)

    def _per_level(self, elements: torch.Tensor) -> torch.Tensor:
        """Sum over what is executed and real of elements [B, H, width]."""
        counted = elements[np.s_[:, : self.executed, : self.action_size]]
        return per_level(counted, self.log_prob_level)

    def get_dist(self, tensordict: TensorDictBase) -> Distribution:
        """Return the density of the batch's own chain, [B] or finer.

        Raises:
            DataError: the batch holds no sample.
        """
        chain = stored_sample(tensordict)
        noisy = None
        if self.chain.noisy_steps == "one":
            noisy = read(tensordict, DENOISE_STEP).to(self.device)
        velocity = velocity_given(self.model, self.prefix(tensordict))
        log_prob, entropy = self.chain.density(
            velocity, self.noise, chain.to(self.device), noisy
        )
        return PathDistribution(
            chain,
            self._per_level(log_prob).to(chain.device),
            self._per_level(entropy).to(chain.device),
        )

    def imitation_loss(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return each step's flow-matching error [B, H] at a time and noise drawn anew.

        Args:
            tensordict: observations, or their prefix, and ``("vla_action", "chunk")``
                [B, H, A], raw.

        Raises:
            DataError: the chunk is missing or of another shape than the checkpoint's.
        """
        chunk = read(tensordict, CHUNK)
        shape = (*tensordict.batch_size, self.chunk, self.action_size)
        if chunk.shape != shape:
            raise DataError(
                f"demonstrated chunks have shape {tuple(chunk.shape)}, the "
                f"checkpoint's {shape}; load the data with chunk={self.chunk}."
            )
        target = self.inputs.normalize(chunk).to(self.device)
        target = functional.pad(target, (0, self.width - self.action_size))
        velocity = velocity_given(self.model, self.prefix(tensordict))
        noise = self.policy.model.sample_noise(target.shape, target.device)
        time = self.policy.model.sample_time(len(target), target.device)
        error = squared_error(velocity, target, time[:, None], noise[:, None])[:, 0]
        if not self.padded_mean:
            error = error[..., : self.action_size]
        return error.mean(-1)
