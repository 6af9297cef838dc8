"""Rollouts of environments in this process, as TorchRL's collector steps them."""

from __future__ import annotations

from typing import Any, Protocol

from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose, ExcludeTransform
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco import keys
from rlco.collectors.patience import impatient
from rlco.collectors.rollout_checks import FiniteRollout
from rlco.envs.chunk_env import ChunkEnv


class Rollouts(Protocol):
    """What plays: environments here, or elsewhere."""

    def play(self, iteration: int) -> TensorDictBase:
        """Return the rollout of one iteration, (N, T), as it was played."""

    def close(self) -> None:
        """Free what it holds."""


class LocalRollouts:
    """Plays one episode of each environment.

    Args:
        env: Of `rlco.envs.make_env`.
        policy: Acts.
        read: Keys that policy and critic read: these are checked to be finite.
        decisions: T, of an episode.
        part: Which part of the episodes of an iteration these environments play.
        parts: How many parts there are, of as many environments each.
    """

    def __init__(
        self,
        env: ChunkEnv,
        policy: Any,
        read: frozenset[Any],
        *,
        decisions: int,
        part: int = 0,
        parts: int = 1,
    ) -> None:
        self._env, self._part, self._parts = env, part, parts
        self._finite = FiniteRollout(read)
        self._collector = Collector(
            checked(env, self._finite),
            policy,
            frames_per_batch=env.batch_size.numel() * decisions,
            total_frames=-1,
            reset_at_each_iter=True,
            auto_register_policy_transforms=False,
        )
        self._batches = iter(self._collector)

    def play(self, iteration: int) -> TensorDictBase:
        """Return the rollout of one iteration, (N, T)."""
        self._env.start_at(iteration * self._parts + self._part)
        self._finite.begin(iteration)
        watched = impatient(lambda: self._finite.decision, f"rollout {iteration}")
        with watched, set_exploration_type(ExplorationType.RANDOM):
            rollout: TensorDictBase = next(self._batches)
        return rollout

    def close(self) -> None:
        """Free the collector and the environments."""
        self._collector.shutdown()


def checked(env: ChunkEnv, finite: FiniteRollout) -> TransformedEnv:
    """Return an environment that stops at what is not finite, without its texts.

    Text is not trained on, and costs more to stack than everything else.
    """
    return TransformedEnv(env, Compose(ExcludeTransform(keys.INSTRUCTION), finite))
