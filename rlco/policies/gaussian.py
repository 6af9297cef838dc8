"""A Gaussian over whole action chunks, for low-dimensional observations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, get_args

import torch
from tensordict import TensorDictBase
from tensordict.nn import InteractionType, TensorDictModuleBase
from tensordict.nn.probabilistic import interaction_type
from torch import nn
from torch.distributions import Distribution, Independent, Normal

from rlco.errors import ConfigError, DataError
from rlco.keys import ACTION, CHUNK, LOG_PROB, SAMPLE
from rlco.policies.actor import Imitation
from rlco.policies.encoder import ObservationEncoder, Quantiles, read
from rlco.policies.mlp import Activation, Mlp
from rlco.policies.normalizer import QuantileNormalizer

#: An action number that moved less than this in the demonstrations (raw units; the
#: limits are 2 apart) keeps this range: see :class:`GaussianPolicy`.
MIN_ACTION_RANGE = 0.2
#: A learned standard deviation stays within this, in the normalised action space.
STD_LIMITS = (0.01, 1.0)
_SAMPLED = (None, InteractionType.RANDOM)


class _Std(nn.Module):
    """Standard deviation of each action number [A]: a buffer, or learned."""

    log_std: torch.Tensor

    def __init__(self, std: Sequence[float], *, learned: bool) -> None:
        super().__init__()
        self.initial = tuple(math.log(value) for value in std)
        log_std = torch.tensor(self.initial)
        if learned:
            self.log_std = nn.Parameter(log_std)
        else:
            self.register_buffer("log_std", log_std)

    def reset_parameters(self) -> None:
        with torch.no_grad():
            self.log_std.copy_(torch.tensor(self.initial))

    def forward(self) -> torch.Tensor:
        log_std = self.log_std
        log_std = log_std.to(torch.promote_types(log_std.dtype, torch.float32))
        if isinstance(self.log_std, nn.Parameter):
            low, high = STD_LIMITS
            log_std = log_std.clamp(math.log(low), math.log(high))
        return log_std.exp()


class GaussianPolicy(TensorDictModuleBase):
    """Independent Gaussians about a chunk that a multi-layer perceptron proposes.

    Mean [B, H, A] and sample live in the normalised action space, where the 1 % and
    99 % quantiles of the demonstrated actions are -1 and 1, and so do all
    log-probabilities. Raw actions are the un-normalised sample, clipped to the action
    limits [-1, 1]; the sample itself is not clipped, for its density to stay Gaussian.

    An action number that hardly moves in the demonstrations is not squeezed onto its
    one value: its range is widened to ``MIN_ACTION_RANGE`` = 0.2 about that value.
    The mean is unbounded, so the policy still reaches every raw action there;
    exploration only stays small (a standard deviation of 0.2 is 0.02 raw), as noise in
    a rotation that no demonstration uses would add up over an episode.

    Called, it writes ``("vla_action", "sample")`` [B, H, A], normalised,
    ``("vla_action", "log_probs")`` [B], ``("vla_action", "chunk")`` and ``action``
    [B, H, A], raw. It samples unless TorchRL's exploration type asks for the mode, the
    mean or the deterministic action, which all are the mean. Weights may be bfloat16;
    log-probabilities and losses are computed in float32 (float64 in float64).

    Args:
        state_size: numbers in the state.
        chunk: steps H of a chunk.
        action_size: action numbers A.
        environment_state_size: numbers in the environment state; 0: not read.
        num_instructions: instructions to tell apart; 0: not read.
        hidden: width of each hidden layer.
        activation: "silu" or "tanh".
        layer_norm: whether hidden layers are normalised.
        std: standard deviation in the normalised action space, one or A of them.
        learn_std: whether it is a parameter [A], independent of the state and kept
            within ``STD_LIMITS``, instead of a buffer.
        imitation: "mse", the mean over action numbers of the mean's squared error, or
            "nll", the sum over action numbers of the negative log-likelihood.

    Raises:
        ConfigError: sizes or standard deviations that are not positive, or a name
            that is not known.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> policy = GaussianPolicy(3, chunk=4, num_instructions=2, hidden=(16,))
        >>> td = TensorDict(
        ...     {"observation": {"state": torch.zeros(5, 3)},
        ...      "instruction_id": torch.zeros(5, dtype=torch.int64)}, [5])
        >>> td = policy(td)
        >>> td["action"].shape, td["vla_action", "log_probs"].shape
        (torch.Size([5, 4, 7]), torch.Size([5]))
    """

    kind: ClassVar[str] = "gaussian"

    def __init__(
        self,
        state_size: int,
        *,
        chunk: int,
        action_size: int = 7,
        environment_state_size: int = 0,
        num_instructions: int = 0,
        hidden: Sequence[int] = (256, 256),
        activation: Activation = "silu",
        layer_norm: bool = False,
        std: float | Sequence[float] = 0.2,
        learn_std: bool = False,
        imitation: Imitation = "mse",
    ) -> None:
        super().__init__()
        stds = (std,) * action_size if isinstance(std, (int, float)) else tuple(std)
        _check(chunk, action_size, stds, imitation)
        self.arguments: dict[str, Any] = {
            "state_size": state_size,
            "chunk": chunk,
            "action_size": action_size,
            "environment_state_size": environment_state_size,
            "num_instructions": num_instructions,
            "hidden": list(hidden),
            "activation": activation,
            "layer_norm": layer_norm,
            "std": list(stds),
            "learn_std": learn_std,
            "imitation": imitation,
        }
        self.chunk, self.action_size, self.imitation = chunk, action_size, imitation
        self.encoder = ObservationEncoder(
            state_size, environment_state_size, num_instructions
        )
        # A small gain: the first chunk is the middle of the demonstrated actions.
        self.network = Mlp(
            self.encoder.size,
            chunk * action_size,
            hidden=hidden,
            activation=activation,
            layer_norm=layer_norm,
            gain=0.01,
        )
        self.std = _Std(stds, learned=learn_std)
        self.action_normalizer = QuantileNormalizer(
            action_size, name="action", min_range=MIN_ACTION_RANGE
        )
        self.in_keys = self.encoder.in_keys
        self.dist_sample_keys: list[Any] = [SAMPLE]
        self.log_prob_keys: list[Any] = [LOG_PROB]
        self.out_keys = [SAMPLE, LOG_PROB, CHUNK, ACTION]

    def set_normalization(
        self,
        *,
        state: Quantiles | None = None,
        environment_state: Quantiles | None = None,
        action: Quantiles | None = None,
    ) -> None:
        """Fix the normalisation, once, before Stage I, from quantiles (low, high).

        Args:
            state: quantiles of the state, each of shape (state_size,), raw units.
            environment_state: quantiles of the environment state.
            action: quantiles of the action numbers, each of shape (action_size,).

        Raises:
            DataError: quantiles of another size, not finite, or of what is not read.
        """
        self.encoder.set_normalization(state=state, environment_state=environment_state)
        if action is not None:
            self.action_normalizer.set_quantiles(*action)

    def get_dist(self, tensordict: TensorDictBase) -> Distribution:
        """Return the distribution of the sample; ``log_prob`` and ``entropy`` are [B].

        Both sum over the chunk's steps and action numbers.
        """
        return Independent(self._normal(tensordict), 2, validate_args=False)

    def _normal(self, tensordict: TensorDictBase) -> Normal:
        """Return the distribution of each action number, [B, H, A]."""
        flat = self.network(self.encoder(tensordict))
        mean = flat.unflatten(-1, (self.chunk, self.action_size))
        return Normal(mean, self.std().expand_as(mean), validate_args=False)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write sample, log-probability, chunk and action into ``tensordict``."""
        dist = self.get_dist(tensordict)
        sample = dist.sample() if interaction_type() in _SAMPLED else dist.mean
        raw = self.action_normalizer.inverse(sample).clamp(-1.0, 1.0)
        tensordict.set(SAMPLE, sample)
        tensordict.set(LOG_PROB, dist.log_prob(sample))
        tensordict.set(CHUNK, raw)
        tensordict.set(ACTION, raw)
        return tensordict

    def imitation_loss(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return each step's distance [B, H] to the demonstrated chunk.

        Args:
            tensordict: observations and ``("vla_action", "chunk")`` [B, H, A], raw.

        Raises:
            DataError: the chunk is missing or of another shape than the policy's.
        """
        target = self.action_normalizer(read(tensordict, CHUNK))
        normal: Distribution = self._normal(tensordict)
        if target.shape != normal.mean.shape:
            raise DataError(
                f"demonstrated chunks have shape {tuple(target.shape)}, the policy's "
                f"{tuple(normal.mean.shape)}; build both with the same chunk length."
            )
        if self.imitation == "mse":
            error: torch.Tensor = normal.mean - target
            return error.square().mean(-1)
        return -normal.log_prob(target).sum(-1)


def _check(
    chunk: int, action_size: int, stds: tuple[float, ...], imitation: str
) -> None:
    problems = []
    if chunk < 1 or action_size < 1:
        problems.append(
            f"chunk={chunk} and action_size={action_size} must be at least 1"
        )
    if len(stds) != action_size or not all(
        math.isfinite(std) and std > 0 for std in stds
    ):
        problems.append(
            f"std={list(stds)} must be one positive number, or {action_size} of them"
        )
    if imitation not in get_args(Imitation):
        known = ", ".join(get_args(Imitation))
        problems.append(f"unknown imitation {imitation!r}; known: {known}")
    if problems:
        raise ConfigError(problems)
