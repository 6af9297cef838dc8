"""The value networks that stand beside a policy in PPO."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn

from rlco.errors import ConfigError
from rlco.keys import STATE_VALUE, TIME_LEFT
from rlco.policies.nets.encoder import ObservationEncoder, Quantiles, read
from rlco.policies.nets.image_encoder import ImageArguments
from rlco.policies.nets.mlp import Activation, Mlp


class ValueNetwork(TensorDictModuleBase):
    """Expected return of a state, one number a decision: ``state_value`` [B, 1].

    It reads through an encoder of its own and shares no parameter with the policy, so
    that the critic's gradient never moves the policy. It may read more than that, or
    less: a critic lives in the simulator alone.

    Args:
        state_size: dimension of the state.
        environment_state_size: dimension of the environment state; 0: not read.
        num_instructions: instructions to tell apart; 0: not read.
        image: how images are read, see `rlco.policies.ImageArguments`; None: not.
        hidden: width of each hidden layer.
        activation: "silu" or "tanh".
        layer_norm: whether hidden layers are normalised.
        time_left: whether it reads ``("observation", "time_left")`` [B, 1], too. What
            is still to come depends on how long an episode goes on, which nothing else
            in an observation tells (Pardo et al., arXiv 1712.00378). Calls without
            that entry then raise DataError.

    Raises:
        ConfigError: sizes that are not positive, or an unknown activation.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> value = ValueNetwork(3, hidden=(16,))
        >>> td = TensorDict({"observation": {"state": torch.zeros(5, 3)}}, [5])
        >>> value(td)["state_value"].shape
        torch.Size([5, 1])
    """

    def __init__(
        self,
        state_size: int,
        *,
        environment_state_size: int = 0,
        num_instructions: int = 0,
        image: ImageArguments | None = None,
        hidden: Sequence[int] = (256, 256),
        activation: Activation = "silu",
        layer_norm: bool = False,
        time_left: bool = False,
    ) -> None:
        super().__init__()
        self.encoder = ObservationEncoder(
            state_size, environment_state_size, num_instructions, image
        )
        self.network = Mlp(
            self.encoder.size + time_left,
            1,
            hidden=hidden,
            activation=activation,
            layer_norm=layer_norm,
            gain=1.0,
        )
        self.time_left = time_left
        self.in_keys = _in_keys(self.encoder.in_keys, time_left)
        self.out_keys = [STATE_VALUE]

    def set_normalization(
        self,
        *,
        state: Quantiles | None = None,
        environment_state: Quantiles | None = None,
    ) -> None:
        """Fix the normalisation from quantiles (low, high) of the training data.

        Raises:
            DataError: quantiles of another size, not finite, or of what is not read.
        """
        self.encoder.set_normalization(state=state, environment_state=environment_state)

    def own_parameters(self) -> list[nn.Parameter]:
        """Return its parameters; it shares none with a policy."""
        return list(self.parameters())

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``state_value`` [B, 1] into ``tensordict``."""
        features = self.encoder(tensordict)
        if self.time_left:
            features = _with_time_left(features, tensordict)
        tensordict.set(STATE_VALUE, self.network(features))
        return tensordict


class ValueHead(TensorDictModuleBase):
    """A value read from what a token policy knows before its first token.

    A perceptron on the state that predicts the first token, as OpenVLA's critics have
    it (RL4VLA, Liu et al., arXiv 2505.19789): no second network reads the observation.
    The policy is a submodule; an optimiser of the critic takes ``own_parameters``.

    Args:
        policy: offers ``first_state(td)`` [B, width].
        hidden: width of each hidden layer of the head.
        detach: whether the critic's gradient stops at the policy.
        time_left: whether it reads the time left, too, see `ValueNetwork`.

    Raises:
        ConfigError: a policy without such a state.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from rlco.policies import TokenPolicy
        >>> value = ValueHead(TokenPolicy(3, chunk=2, width=16), hidden=(16,))
        >>> td = TensorDict({"observation": {"state": torch.zeros(5, 3)}}, [5])
        >>> value(td)["state_value"].shape
        torch.Size([5, 1])
    """

    def __init__(
        self,
        policy: Any,
        *,
        hidden: Sequence[int] = (256,),
        detach: bool = True,
        time_left: bool = False,
    ) -> None:
        super().__init__()
        if not callable(getattr(policy, "first_state", None)):
            raise ConfigError(
                [
                    f"{type(policy).__name__} has no state that a value could be read "
                    "from; use a ValueNetwork"
                ]
            )
        self.policy, self.detach, self.time_left = policy, detach, time_left
        self.head = Mlp(policy.arguments["width"] + time_left, 1, hidden=hidden)
        self.in_keys = _in_keys(policy.in_keys, time_left)
        self.out_keys = [STATE_VALUE]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``state_value`` [B, 1] into ``tensordict``."""
        state = self.policy.first_state(tensordict)
        state = state.detach() if self.detach else state
        if self.time_left:
            state = _with_time_left(state, tensordict)
        tensordict.set(STATE_VALUE, self.head(state))
        return tensordict

    def own_parameters(self) -> list[nn.Parameter]:
        """Return the head's parameters: those that are not the policy's."""
        return list(self.head.parameters())


def _in_keys(observed: Sequence[Any], time_left: bool) -> list[Any]:
    return [*observed, TIME_LEFT] if time_left else list(observed)


def _with_time_left(features: torch.Tensor, tensordict: TensorDictBase) -> torch.Tensor:
    """Append the time left to features [B, F], as a number within [-1, 1]."""
    left = 2 * read(tensordict, TIME_LEFT) - 1
    return torch.cat([features, left.to(features)], -1)
