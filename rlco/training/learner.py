"""What Stage II trains, and one rollout's worth of training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.nn.utils import clip_grads_with_norm_
from torch.optim import Optimizer

from rlco import keys
from rlco.finite import check_step, check_weights, gradient_norm
from rlco.losses.co_training import CoTrainingLoss
from rlco.losses.gradient_agreement import gradient_agreement
from rlco.losses.gradient_signal import LEAST_GROUPS, gradient_signal
from rlco.losses.log_probs import log_probs
from rlco.training.anchor_weight import AnchorWeight
from rlco.training.distributed.joint_loss import JointLoss
from rlco.training.distributed.ranks import Ranks

#: Clip of the critic's gradient norm: it cuts off outliers and nothing else.
CRITIC_GRAD_NORM = 10.0
#: Numbers of an update of which the largest counts, not the mean.
LARGEST = ("log_prob_gap", "first_ratio")
#: Groups of episodes whose gradients tell signal from noise.
GROUPS = 8
#: Demonstrated rows, at most, whose gradient is the anchor's.
ANCHOR_ROWS = 4096


@dataclass
class Learner:
    """A policy, its critic where there is one, their loss, rows and optimisers.

    With ``reuse`` a rollout is learned from together with earlier ones. The ratio of
    their decisions starts at 1 like that of new ones; their advantages, as they were
    estimated then, are weighted by how much more likely the policy is to decide so now
    than when it played them, at most 1: truncated importance weights (IMPALA, arXiv
    1802.01561), apart from the ratio that is clipped (arXiv 2110.00641).

    Attributes:
        policy: The actor of the loss.
        critic: None with critic-free advantages; offers ``own_parameters()``.
        loss: PPO on ``sim``, imitation on ``real``.
        buffer: A `rlco.data.SimRealReplayBuffer`, whose sim side holds the rollout.
        actor_optimizer: Of the policy's parameters.
        critic_optimizer: Of the critic's own parameters; None without one.
        minibatch: Simulated decisions of a minibatch.
        max_grad_norm: Clip of the policy's gradient norm, both terms together.
        target_kl: No further pass follows one over which the policy's mean KL
            divergence from the one that played was larger [nats]; None: all do.
        lr_final: Both learning rates after the last rollout, as a share of what they
            are at the first; they change linearly.
        reuse: Earlier rollouts that are learned from again. The buffer's sim side has
            room for them.
        anchor: Adapts the anchor's weight after each rollout that moved the policy;
            None: it stays as the loss was built.
        ranks: Which of the processes this is that learn together, each from rollouts
            and real rows of its own. Their weights stay equal to the last bit.
    """

    policy: Any
    critic: Any
    loss: CoTrainingLoss
    buffer: Any
    actor_optimizer: Optimizer
    critic_optimizer: Optimizer | None
    minibatch: int
    max_grad_norm: float = 1.0
    target_kl: float | None = None
    lr_final: float = 1.0
    reuse: int = 0
    anchor: AnchorWeight | None = None
    ranks: Ranks = field(default_factory=Ranks)
    _joint: CoTrainingLoss | JointLoss = field(init=False)
    _earlier: list[TensorDictBase] = field(default_factory=list, init=False)
    _updates: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        joint = None if self.ranks.alone else JointLoss(self.loss, self.ranks)
        self._joint = self.loss if joint is None else joint

    def draw_own(self, rollout: int) -> None:
        """Let this rank's actions and real rows be its own, those of one rollout.

        A process alone goes on as it was.
        """
        self.ranks.draw_own(rollout)
        if (seed := self.ranks.own_seed(rollout)) is not None:
            self.buffer.reseed(seed)

    def anneal(self, done: float) -> None:
        """Set the learning rates to those of a point of the training.

        Called before each rollout. A resumed run sets what an uninterrupted one does.

        Args:
            done: Share of the rollouts that have been learned from, 0 to 1.
        """
        if self.lr_final == 1.0:
            return
        share = 1 - (1 - self.lr_final) * done
        for optimizer in (self.actor_optimizer, self.critic_optimizer):
            for group in optimizer.param_groups if optimizer is not None else ():
                first = group.setdefault("initial_lr", group["lr"])
                group["lr"] = first * share

    def update(
        self,
        rollout: TensorDictBase,
        epochs: int,
        *,
        train_policy: bool = True,
        measure: bool = False,
    ) -> dict[str, float]:
        """Pass over a rollout, each minibatch with freshly drawn real rows.

        The old log-probability is computed here, on the rows it will be compared on:
        the first ratio is 1.

        Args:
            rollout: Decisions with advantages, shape (episodes, decisions).
            epochs: Passes.
            train_policy: Whether the policy moves, or the critic alone.
            measure: Whether the anchor is compared with PPO's mean gradient first,
                which takes about as long as one pass.

        Returns:
            Means over the minibatches, of all ranks, of what the loss reports;
            ``epochs``, the passes
            that were made; ``forgotten`` and ``real_coeff`` where the anchor's weight
            is adapted; ``reuse_weight``, the mean weight of what is learned from
            again, if anything is; ``log_prob_gap``, how far the rollout's own
            log-probability was off at most; ``first_ratio``, the largest ratio of the
            first minibatch; and, where there is an anchor, the gradients' comparison
            in the first minibatch.

        Raises:
            NonFiniteError: The loss, its gradient or a weight is NaN or infinite. No
                step follows such a gradient.
        """
        row = self._store(rollout)
        if measure and self.buffer.real is not None:
            row |= self._signal(rollout)
        self._updates = 0
        sums: dict[str, float] = {}
        minibatches = 0
        # A policy that stays differs from itself by rounding alone.
        limit = self.target_kl if train_policy else None
        for epoch in range(1, epochs + 1):
            divergences = []
            for batch in self.buffer:
                if minibatches == 0 and keys.REAL in batch:
                    row |= gradient_agreement(self.loss, batch)
                out = self._joint(batch)
                if minibatches == 0:
                    row["first_ratio"] = float(out["max_ratio"])
                self._step(out, train_policy=train_policy)
                minibatches += 1
                for name, value in out.items():
                    sums[name] = sums.get(name, 0.0) + _number(value)
                if limit is not None:
                    divergences.append(float(out["kl_approx"].detach()))
            row["epochs"] = epoch
            if limit is not None and self._divergence(divergences) > limit:
                break
        self._check_weights()
        if self.anchor is not None and train_policy:
            row |= self.anchor.adapt(self.loss)
            # The same on all ranks, unless their processors round differently.
            self.loss.real_coeff = self.ranks.from_lead(float(self.loss.real_coeff))
        row |= {name: total / minibatches for name, total in sums.items()}
        return self._of_all(row)

    def _divergence(self, divergences: Sequence[float]) -> float:
        """Return a pass's mean KL divergence over all ranks: they stop together."""
        return self.ranks.mean({"kl": fmean(divergences)})["kl"]

    def _of_all(self, row: dict[str, float]) -> dict[str, float]:
        """Return what all ranks' numbers come to; counts are the same on all."""
        most = {name: row[name] for name in LARGEST if name in row}
        others = {
            name: value
            for name, value in row.items()
            if name not in most and not isinstance(value, int)
        }
        return row | self.ranks.mean(others) | self.ranks.largest(most)

    def _store(self, rollout: TensorDictBase) -> dict[str, float]:
        """Put a rollout into the buffer, with the learner's own log-probability."""
        kept = [*self.policy.replay_keys, keys.LOG_PROB, keys.ADVANTAGE]
        if self.critic is not None:
            kept += [*self.critic.in_keys, keys.VALUE_TARGET, keys.STATE_VALUE]
        flat = rollout.select(*kept).reshape(-1)  # text and raw actions stay behind
        computed = log_probs(self.policy, flat, rows=self.minibatch)
        gap = (computed - flat[keys.LOG_PROB]).abs().max()
        flat.set(keys.LOG_PROB, computed)
        self.buffer.empty()
        self.buffer.extend(flat)
        row = {"log_prob_gap": float(gap)}
        weights = [self._add_again(earlier) for earlier in self._earlier]
        if weights:
            row["reuse_weight"] = float(torch.cat(weights).mean())
        self._earlier = [flat, *self._earlier][: self.reuse]
        return row

    def _add_again(self, flat: TensorDictBase) -> Tensor:
        """Put an earlier rollout's decisions into the buffer; return their weights."""
        now = log_probs(self.policy, flat, rows=self.minibatch)
        change = now - flat[keys.LOG_PROB]
        # Of the decision, whatever part of it one log-probability covers.
        whole = change.reshape(len(change), -1).sum(-1)
        weight: Tensor = whole.exp().clamp(max=1.0)
        advantage = flat[keys.ADVANTAGE] * weight.unsqueeze(-1)
        again = flat.copy().update({keys.LOG_PROB: now, keys.ADVANTAGE: advantage})
        self.buffer.extend(again)
        return weight

    def _signal(self, rollout: TensorDictBase) -> dict[str, float]:
        """Compare the anchor with PPO's mean gradient, before the policy moves."""
        rows = self.buffer.sim[: rollout.numel()].reshape(rollout.shape)
        groups = rows.split(-(-len(rows) // GROUPS))
        if len(groups) < LEAST_GROUPS:
            return {}
        demonstrated = self.buffer.real[:]
        step = -(-len(demonstrated) // ANCHOR_ROWS)
        return gradient_signal(
            self.loss,
            [group.reshape(-1) for group in groups],
            demonstrated[::step],
            rows=self.minibatch,
        )

    def _step(self, out: TensorDictBase, *, train_policy: bool) -> None:
        """Follow the gradient of a loss's terms once."""
        self.actor_optimizer.zero_grad()
        if self.critic_optimizer is not None:
            self.critic_optimizer.zero_grad()
        terms = {k: v for k, v in out.items() if k.startswith("loss_")}
        sum(terms.values()).backward()
        parts: list[tuple[list[nn.Parameter], float]] = []
        if self.critic_optimizer is not None:
            parts.append((self.critic.own_parameters(), CRITIC_GRAD_NORM))
        if train_policy:
            parts.append((list(self.policy.parameters()), self.max_grad_norm))
        self._clip([terms], parts)
        if self.critic_optimizer is not None:
            self.critic_optimizer.step()
        if train_policy:
            self.actor_optimizer.step()

    def _clip(
        self,
        terms: Sequence[Mapping[str, Tensor]],
        parts: Sequence[tuple[Sequence[nn.Parameter], float]],
    ) -> None:
        """Clip each part's gradients to its limit, where they and the terms are finite.

        Args:
            terms: The loss's terms, of every minibatch that the gradients come from.
            parts: Weights that are clipped together, with the limit of their norm.
        """
        self._updates += 1
        norms = [gradient_norm(part) for part, _ in parts]
        named = [pair for one in terms for pair in one.items()]
        check_step(self._now(), named, norms, self._modules())
        for (part, limit), norm in zip(parts, norms, strict=True):
            clip_grads_with_norm_(part, limit, norm)

    def _check_weights(self) -> None:
        check_weights(self._now(), self._modules())

    def _now(self) -> str:
        return f"update {self._updates} of the rollout"

    def _modules(self) -> dict[str, nn.Module]:
        both = {"policy": self.policy, "critic": self.critic}
        return {name: part for name, part in both.items() if part is not None}

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint holds: of rollouts those to learn from again."""
        state: dict[str, Any] = {
            name: dict(part.state_dict()) for name, part in self._parts().items()
        }
        state["buffer"] = self.buffer.state_dict(rows=False)
        if self.reuse:
            every = [self.ranks.joined(one) for one in self._earlier]
            state["earlier"] = [dict(one.flatten_keys("/")) for one in every]
        if self.anchor is not None:
            state["real_coeff"] = float(self.loss.real_coeff)
        return state

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        for name, part in self._parts().items():
            part.load_state_dict(state[name])
        self.buffer.load_state_dict(state["buffer"])
        if self.anchor is not None:
            self.loss.real_coeff = state["real_coeff"]
        earlier = [
            TensorDict(one, [len(one["/".join(keys.LOG_PROB)])]).unflatten_keys("/")
            for one in state.get("earlier", ())
        ]
        self._earlier = [self.ranks.own(one) for one in earlier]

    def _parts(self) -> dict[str, Any]:
        names = ("policy", "critic", "actor_optimizer", "critic_optimizer")
        found = {name: getattr(self, name) for name in names}
        return {name: part for name, part in found.items() if part is not None}


def _number(value: Tensor) -> float:
    """Return what a loss reports as one number.

    TorchRL's effective sample size is one for each part of a decision that has a ratio
    of its own.
    """
    value = value.detach()
    return float(value if value.numel() == 1 else value.mean())
