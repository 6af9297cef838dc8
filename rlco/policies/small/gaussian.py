"""A Gaussian over whole action chunks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Literal, get_args

import torch
from tensordict import TensorDictBase
from torch import nn
from torch.distributions import Distribution, Independent, Normal

from rlco.errors import ConfigError
from rlco.keys import LOG_PROB, SAMPLE
from rlco.physics.spec.actions import LIMIT
from rlco.policies.nets.image_encoder import ImageArguments
from rlco.policies.nets.mlp import Activation, Mlp
from rlco.policies.small.chunk_policy import ChunkPolicy

#: The per-step imitation losses that it offers.
Imitation = Literal["mse", "nll"]
#: A learned standard deviation stays within this, in the normalised action space.
STD_LIMITS = (0.01, 1.0)


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


class GaussianPolicy(ChunkPolicy):
    """Independent Gaussians about a chunk that a multi-layer perceptron proposes.

    Mean [B, H, A], sample and log-probabilities live in the normalised action space,
    see :class:`rlco.policies.ChunkPolicy`. Raw actions are the un-normalised sample,
    clipped to the action limits [-1, 1]; the sample itself is not clipped, for its
    density to stay Gaussian. The mean is unbounded, so the policy reaches every raw
    action, also of a number that hardly moves in the demonstrations; a standard
    deviation of 0.2 is 0.02 raw there.

    Called, it writes ``("vla_action", "sample")`` [B, H, A], normalised,
    ``("vla_action", "log_probs")`` [B], ``("vla_action", "chunk")`` and ``action``
    [B, H, A], raw. It samples unless TorchRL's exploration type asks for the mode, the
    mean or the deterministic action, which all are the mean. Weights may be bfloat16;
    log-probabilities and losses are computed in float32 (float64 in float64).

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
        activation: "silu" or "tanh".
        layer_norm: whether hidden layers are normalised.
        std: standard deviation in the normalised action space, one or A of them.
        learn_std: whether it is a parameter [A], independent of the state and kept
            within ``STD_LIMITS``, instead of a buffer.
        imitation: "mse", the squared error of the mean, averaged over action
            dimensions, or "nll", the negative log-likelihood, summed over them.

    Raises:
        ConfigError: sizes or standard deviations that are not positive, or a name
            that is not known.
        CheckpointError: the image encoder's weights cannot be loaded.

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
        image: ImageArguments | None = None,
        action_limit: float | None = LIMIT,
        guidance: float | None = None,
        hidden: Sequence[int] = (256, 256),
        activation: Activation = "silu",
        layer_norm: bool = False,
        std: float | Sequence[float] = 0.2,
        learn_std: bool = False,
        imitation: Imitation = "mse",
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
        stds = (std,) * action_size if isinstance(std, (int, float)) else tuple(std)
        _check(action_size, stds, imitation)
        self.arguments |= {
            "hidden": list(hidden),
            "activation": activation,
            "layer_norm": layer_norm,
            "std": list(stds),
            "learn_std": learn_std,
            "imitation": imitation,
        }
        self.imitation = imitation
        # A small gain: the first chunk is the middle of the demonstrated actions.
        self.network = Mlp(
            self.feature_size,
            chunk * action_size,
            hidden=hidden,
            activation=activation,
            layer_norm=layer_norm,
            gain=0.01,
        )
        self.std = _Std(stds, learned=learn_std)

    def get_dist(self, tensordict: TensorDictBase) -> Distribution:
        """Return the distribution of the sample; ``log_prob`` and ``entropy`` are [B].

        Both sum over the chunk's steps and action dimensions.
        """
        features = self.acting_features(tensordict)
        flat = self.guided(map(self.network, features))
        return Independent(self._normal(flat), 2, validate_args=False)

    def _normal(self, flat: torch.Tensor) -> Normal:
        """Return each action number's distribution [B, H, A] about means [B, HA]."""
        mean = flat.view(*flat.shape[:-1], self.chunk, self.action_size)
        return Normal(mean, self.std().expand_as(mean), validate_args=False)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write sample, log-probability, chunk and action into ``tensordict``."""
        self.store_images(tensordict)
        dist = self.get_dist(tensordict)
        sample = dist.sample() if self.explores else dist.mean
        tensordict.set(SAMPLE, sample)
        tensordict.set(LOG_PROB, dist.log_prob(sample))
        self.act(tensordict, sample)
        return tensordict

    def imitation_loss(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return each step's distance [B, H] to the demonstrated chunk.

        Args:
            tensordict: observations and ``("vla_action", "chunk")`` [B, H, A], raw.

        Raises:
            DataError: the chunk is missing or of another shape than the policy's.
        """
        target = self.demonstrated(tensordict)
        normal: Distribution = self._normal(self.network(self.features(tensordict)))
        if self.imitation == "mse":
            error: torch.Tensor = normal.mean - target
            return error.square().mean(-1)
        return -normal.log_prob(target).sum(-1)


def _check(action_size: int, stds: tuple[float, ...], imitation: str) -> None:
    problems = []
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
