"""One rollout's worth of training for models of billions of weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor, nn

from rlco.errors import CheckpointError
from rlco.training.learner import CRITIC_GRAD_NORM, Learner


@dataclass
class LargeLearner(Learner):
    """A learner whose updates follow several minibatches at once.

    The actor's optimiser holds what LeRobot's own training optimises, and nothing
    else, so that LeRobot can go on with it.

    Attributes:
        policy: Has also ``noise``, the network of its steps' noise.
        critic_optimizer: Of what is learned from scratch: the critic where there is
            one, and ``policy.noise``, which moves when the policy does.
        accumulate: Minibatches whose gradients make one update.
    """

    accumulate: int = 1
    _waiting: list[dict[str, Tensor]] = field(default_factory=list, init=False)

    def update(
        self,
        rollout: TensorDictBase,
        epochs: int,
        *,
        train_policy: bool = True,
        measure: bool = False,
    ) -> dict[str, float]:
        """Pass over a rollout, see `rlco.training.Learner.update`."""
        row = super().update(
            rollout, epochs, train_policy=train_policy, measure=measure
        )
        if self._waiting:
            self._follow(train_policy=train_policy)
            self._check_weights()
        return row

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint holds: of the policy only what is trained.

        Frozen weights are those of the model that a resumed run reads anyway.
        """
        state, frozen = super().state(), self._frozen()
        policy = {k: v for k, v in state["policy"].items() if k not in frozen}
        return state | {"policy": policy}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint.

        Raises:
            CheckpointError: Other weights were trained than are to be trained now.
        """
        now = self.policy.state_dict()
        kept = {name: now[name] for name in self._frozen()}
        if kept.keys() | state["policy"].keys() != now.keys():
            raise CheckpointError(
                "the checkpoint holds other trained weights than this run trains; "
                "resume with the same trained= and policy=."
            )
        super().load(state | {"policy": kept | state["policy"]})

    def _frozen(self) -> set[str]:
        named = self.policy.named_parameters(remove_duplicate=False)
        return {name for name, weights in named if not weights.requires_grad}

    def _step(self, out: TensorDictBase, *, train_policy: bool) -> None:
        terms = {k: v for k, v in out.items() if k.startswith("loss_")}
        (sum(terms.values()) / self.accumulate).backward()
        self._waiting.append({name: value.detach() for name, value in terms.items()})
        if len(self._waiting) == self.accumulate:
            self._follow(train_policy=train_policy)

    def _follow(self, *, train_policy: bool) -> None:
        """Follow the gradients that have come together, and forget them."""
        parts: list[tuple[list[nn.Parameter], float]] = []
        if train_policy:
            # The noise is how the policy explores: both are clipped as one.
            parts.append((list(self.policy.parameters()), self.max_grad_norm))
        else:
            self.policy.noise.zero_grad()
        if self.critic is not None:
            parts.append((list(self.critic.parameters()), CRITIC_GRAD_NORM))
        self._clip(self._waiting, parts)
        if train_policy:
            self.actor_optimizer.step()
        if self.critic_optimizer is not None:
            self.critic_optimizer.step()
            self.critic_optimizer.zero_grad()
        self.actor_optimizer.zero_grad()
        self._waiting = []
