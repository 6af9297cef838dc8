"""Whole episodes of a policy in the simulator, with advantages, once an iteration."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import ExcludeTransform
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives.value import GAE

from rlco import keys
from rlco.envs.chunk_env import ChunkEnv


class RolloutCollector:
    """Collects one episode of every environment, and estimates its advantages.

    TorchRL's `Collector` steps; then GAE (Schulman et al., arXiv 1506.02438) runs
    over the whole rollout under ``no_grad``: gamma and lambda count decisions, an
    episode that was truncated bootstraps from its last observation's value, a
    terminated one does not. Advantages are normalised over the whole rollout.

    Iteration k plays the k-th episode of each environment, whatever was played
    before, so that a resumed run sees what an uninterrupted one sees.

    Args:
        env: The simulator.
        policy: Writes `action` and what it needs to recompute its log-probability.
        critic: Writes `state_value` (N, 1).
        gamma: Discount a decision.
        lmbda: GAE's lambda.

    Example:
        >>> from rlco.envs import make_env
        >>> from rlco.policies import GaussianPolicy, ValueNetwork
        >>> env = make_env("push_cube", num_envs=2, chunk=4, horizon=8)
        >>> sizes = dict(environment_state_size=12, num_instructions=3, hidden=(8,))
        >>> policy = GaussianPolicy(7, chunk=4, **sizes)
        >>> critic = ValueNetwork(7, **sizes)
        >>> collector = RolloutCollector(env, policy, critic)
        >>> rollout = collector.collect(0)
        >>> rollout.shape, rollout["advantage"].shape  # (environments, decisions)
        (torch.Size([2, 2]), torch.Size([2, 2, 1]))
    """

    def __init__(
        self,
        env: ChunkEnv,
        policy: Any,
        critic: Any,
        *,
        gamma: float = 0.9,
        lmbda: float = 0.95,
    ) -> None:
        self.env = env
        self.decisions = -(-env.horizon // env.chunk)
        # Text is not trained on, and costs more to stack than everything else.
        quiet = TransformedEnv(env, ExcludeTransform(keys.INSTRUCTION))
        self._collector = Collector(
            quiet,
            policy,
            frames_per_batch=env.batch_size.numel() * self.decisions,
            total_frames=-1,
            reset_at_each_iter=True,
            auto_register_policy_transforms=False,
        )
        self._batches = iter(self._collector)
        self._gae = GAE(
            gamma=gamma, lmbda=lmbda, value_network=critic, average_gae=False
        )

    @property
    def frames(self) -> int:
        """Control steps of one rollout, summed over environments."""
        return int(self.env.batch_size.numel()) * self.env.horizon

    def collect(self, iteration: int) -> TensorDictBase:
        """Return the rollout of one iteration, shape (N, T) decisions.

        Beside what environment and policy wrote it holds `advantage`,
        `value_target` and `state_value`, each (N, T, 1). Decisions in which the
        simulation diverged have advantage 0 and their own value as target.
        """
        self.env.start_at(iteration)
        with set_exploration_type(ExplorationType.RANDOM):
            rollout = next(self._batches)
        with torch.no_grad():
            rollout = self._gae(rollout)
        # What a broken simulation did says nothing of the policy, nor of the critic.
        broken = rollout["next", keys.DIVERGED]
        advantage = rollout[keys.ADVANTAGE]
        value = torch.where(
            broken, rollout[keys.STATE_VALUE], rollout[keys.VALUE_TARGET]
        )
        rollout.set(keys.VALUE_TARGET, value)
        sound = advantage[~broken]
        scaled = (advantage - sound.mean()) / (sound.std() + 1e-5)
        return rollout.set(keys.ADVANTAGE, scaled.masked_fill(broken, 0.0))

    def close(self) -> None:
        """Free the collector."""
        self._collector.shutdown()
