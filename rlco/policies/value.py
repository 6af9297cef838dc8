"""The value network that stands beside a policy in PPO."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from rlco.keys import STATE_VALUE
from rlco.policies.encoder import ObservationEncoder, Quantiles
from rlco.policies.mlp import Activation, Mlp


class ValueNetwork(TensorDictModuleBase):
    """Expected return of a state, one number a decision: ``state_value`` [B, 1].

    It reads what the policy reads through an encoder of its own and shares no
    parameter with it, so that the critic's gradient never moves the policy.

    Args:
        state_size: numbers in the state.
        environment_state_size: numbers in the environment state; 0: not read.
        num_instructions: instructions to tell apart; 0: not read.
        hidden: width of each hidden layer.
        activation: "silu" or "tanh".
        layer_norm: whether hidden layers are normalised.

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
        hidden: Sequence[int] = (256, 256),
        activation: Activation = "silu",
        layer_norm: bool = False,
    ) -> None:
        super().__init__()
        self.encoder = ObservationEncoder(
            state_size, environment_state_size, num_instructions
        )
        self.network = Mlp(
            self.encoder.size,
            1,
            hidden=hidden,
            activation=activation,
            layer_norm=layer_norm,
            gain=1.0,
        )
        self.in_keys = self.encoder.in_keys
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

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``state_value`` [B, 1] into ``tensordict``."""
        tensordict.set(STATE_VALUE, self.network(self.encoder(tensordict)))
        return tensordict
