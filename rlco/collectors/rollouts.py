"""Whole episodes of a policy in the simulator, with advantages, once an iteration."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, get_args

import torch
from tensordict import TensorDictBase
from torchrl.envs.batched_envs import BatchedEnvBase
from torchrl.objectives.value import GAE

from rlco import keys
from rlco.collectors.advantages import Advantage, group_advantages, normalize
from rlco.collectors.local_rollouts import LocalRollouts, Rollouts
from rlco.collectors.rollout_checks import check_computed
from rlco.envs import check_action_units
from rlco.envs.chunk_env import ChunkEnv
from rlco.errors import ConfigError, DataError
from rlco.policies import ValueHead
from rlco.training.distributed.ranks import Ranks

if TYPE_CHECKING:
    from rlco.collectors.ray_rollouts import RayWorkers

_NEEDED = ("start_at", "start_in_groups", "horizon", "chunk")


class RolloutCollector:
    """Collects one episode of every environment, and estimates its advantages.

    TorchRL's `Collector` steps. With ``advantage="gae"``, GAE (Schulman et al.,
    arXiv 1506.02438) then runs over the whole rollout under ``no_grad``: gamma and
    lambda count decisions, an episode that was truncated bootstraps from its last
    observation's value, a terminated one does not. A critic with ``time_left`` is told
    how much of the episode is left, and then no episode bootstraps beyond its end.
    Advantages are normalised over the whole rollout.

    With ``advantage="mc"`` there is no critic: every ``group_size`` neighbouring
    environments start alike, and an episode's advantage is how its return compares
    within its group, see `rlco.collectors.group_advantages`.

    Iteration k plays the k-th episode of each environment, whatever was played
    before, so that a resumed run sees what an uninterrupted one sees.

    Args:
        env: The simulator, of `rlco.envs.make_env`: iteration k starts episode k again,
            which other environments of TorchRL cannot.
        policy: Writes `action` and what it needs to recompute its log-probability.
        critic: Writes `state_value` (N, 1); none with ``advantage="mc"``.
        gamma: Discount a decision; GAE's.
        lmbda: GAE's lambda.
        advantage: "gae" or "mc".
        group_size: Episodes of a group; "mc" alone has groups.
        prepare: Called with each rollout before GAE, to add what the critic reads and
            the environment does not show.
        ranks: The processes that learn together, of which each collects: other episodes
            than the others, those that one with all environments would play.
        workers: Processes of a Ray cluster that play instead of this one: each in an
            environment like ``env``, which is then only asked what it is like.

    Raises:
        ConfigError: "gae" without a critic, groups of one episode, or an environment
            of another kind.
        RlcoError: The number of environments is not a multiple of ``group_size``, or
            the policy acts in other units than the environment takes.

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
        critic: Any | None = None,
        *,
        gamma: float = 0.9,
        lmbda: float = 0.95,
        advantage: Advantage = "gae",
        group_size: int = 8,
        prepare: Callable[[TensorDictBase], None] | None = None,
        ranks: Ranks | None = None,
        workers: RayWorkers | None = None,
    ) -> None:
        _check_env(env)
        check_action_units(policy, env)
        _check(critic, advantage, group_size)
        self._prepare = prepare
        self._ranks = Ranks() if ranks is None else ranks
        self.env = env
        self.group_size = group_size if advantage == "mc" else 1
        env.start_in_groups(self.group_size)
        self.decisions = -(-env.horizon // env.chunk)
        self._workers = 1 if workers is None else workers.count
        self._rollouts = self._make_rollouts(policy, critic, workers)
        self._gae = None
        if advantage == "gae":
            self._gae = GAE(
                gamma=gamma,
                lmbda=lmbda,
                value_network=critic,
                average_gae=False,
                # vmap has no rule for attention, and says so at each call.
                deactivate_vmap=isinstance(critic, ValueHead),
            )

    def _make_rollouts(
        self, policy: Any, critic: Any, workers: RayWorkers | None
    ) -> Rollouts:
        readers = (policy, critic)
        read = frozenset(k for one in readers for k in getattr(one, "in_keys", ()))
        first = {
            "part": self._ranks.rank * self._workers,
            "parts": self._ranks.count * self._workers,
        }
        if workers is None:
            return LocalRollouts(
                self.env, policy, read, decisions=self.decisions, **first
            )
        from rlco.collectors.ray_rollouts import RayRollouts

        frames = self.env.batch_size.numel() * self.decisions
        return RayRollouts(
            workers, policy, read, frames=frames, group_size=self.group_size, **first
        )

    @property
    def frames(self) -> int:
        """Control steps of one rollout of this process, summed over environments."""
        environments = int(self.env.batch_size.numel()) * self._workers
        return environments * self.env.horizon

    def collect(self, iteration: int) -> TensorDictBase:
        """Return the rollout of one iteration, shape (N, T) decisions.

        Beside what environment and policy wrote it holds `advantage`, and with GAE
        `value_target` and `state_value`, each (N, T, 1). Decisions in which the
        simulation diverged have advantage 0 and their own value as target.

        Raises:
            DataError: the critic reads what next observations do not have.
            NonFiniteError: a reward, an observation, an action or a value is NaN or
                infinite.
        """
        rollout = self._estimate(self._rollouts.play(iteration))
        check_computed(rollout, iteration)
        return rollout

    def _estimate(self, rollout: TensorDictBase) -> TensorDictBase:
        """Add advantages, and what the critic learns from."""
        if self._gae is None:
            return rollout.set(
                keys.ADVANTAGE, group_advantages(rollout, self.group_size)
            )
        if self._prepare is not None:
            self._prepare(rollout)
        if keys.TIME_LEFT in self._gae.value_network.in_keys:
            self._add_time_left(rollout)
        _check_next(rollout, self._gae.value_network)
        with torch.no_grad():
            rollout = self._gae(rollout)
        # What a broken simulation did says nothing of the policy, nor of the critic.
        broken = rollout["next", keys.DIVERGED]
        value = torch.where(
            broken, rollout[keys.STATE_VALUE], rollout[keys.VALUE_TARGET]
        )
        rollout.set(keys.VALUE_TARGET, value)
        advantage = normalize(rollout[keys.ADVANTAGE], broken, self._ranks)
        return rollout.set(keys.ADVANTAGE, advantage)

    def _add_time_left(self, rollout: TensorDictBase) -> None:
        """Tell the critic how long an episode goes on; after its end nothing follows.

        A critic that knows the end values what is left of the episode, so that the last
        decision bootstraps from nothing, like one that reached a terminal state.
        """
        device = rollout["next", keys.REWARD].device
        left = 1 - torch.arange(self.decisions + 1, device=device) / self.decisions
        left = left.expand(len(rollout), -1).unsqueeze(-1)
        rollout.set(keys.TIME_LEFT, left[:, :-1].contiguous())
        rollout.set(("next", *keys.TIME_LEFT), left[:, 1:].contiguous())
        terminated = rollout["next", keys.TERMINATED]
        rollout.set(("next", keys.TERMINATED), terminated | (left[:, 1:] == 0))

    def close(self) -> None:
        """Free the collector."""
        self._rollouts.close()


def _check_next(rollout: TensorDictBase, critic: Any) -> None:
    """Check that the critic can value next observations, before TorchRL stacks them."""
    there = rollout["next"].keys(include_nested=True)
    missing = [key for key in critic.in_keys if key not in there]
    if missing:
        raise DataError(
            f"the critic reads {missing[0]!r}, which the rollout's next observations "
            "do not have; add it with RolloutCollector(prepare=...), the summaries of "
            "a large model with add_next_summaries."
        )


def _check_env(env: Any) -> None:
    """Check that an environment can start its k-th episode: iteration k plays that."""
    # Asked of a batched environment that is not started, hasattr never returns.
    batched = isinstance(env, BatchedEnvBase)
    missing = [name for name in _NEEDED if batched or not hasattr(env, name)]
    if missing:
        raise ConfigError(
            [
                f"RolloutCollector plays environments of rlco.envs.make_env, and "
                f"{type(env).__name__} has no {missing[0]!r}: it cannot start a given "
                "episode again; collect from it with torchrl.collectors.Collector and "
                "torchrl.objectives.value.GAE, as docs/environments.md shows"
            ]
        )


def _check(critic: Any | None, advantage: str, group_size: int) -> None:
    problems = []
    if advantage not in get_args(Advantage):
        known = ", ".join(get_args(Advantage))
        problems.append(f"unknown advantage {advantage!r}; known: {known}")
    if advantage == "gae" and critic is None:
        problems.append("advantage='gae' needs a critic; give one, or advantage='mc'")
    if advantage == "mc" and group_size < 2:
        problems.append(
            f"group_size={group_size} leaves nothing to compare; give 2 or more"
        )
    if problems:
        raise ConfigError(problems)
