"""What all of rlco's own environments share: N episodes, one action chunk a step."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NonTensorData, NonTensorStack, TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, NonTensor, Unbounded
from torchrl.envs import EnvBase

from rlco import keys
from rlco.errors import RlcoError, SimulationError
from rlco.physics.spec.actions import LIMIT, ActionRange
from rlco.physics.spec.streams import Stream
from rlco.physics.spec.task import Array

RewardKind = Literal["shaped", "sparse"]
OnDivergence = Literal["reset", "raise"]
ON_DIVERGENCE = ("reset", "raise")
_logger = logging.getLogger(__name__)


class TaskInfo(Protocol):
    """What an environment says of its task."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def instructions(self) -> tuple[str, ...]:
        """Every instruction there is."""

    @property
    def horizon(self) -> int:
        """Length of an episode in control steps."""

    @property
    def control_frequency(self) -> int:
        """Control steps a second [Hz]."""

    def description(self) -> dict[str, Any]:
        """Return what a policy's user must know of it, in types of JSON."""


class ChunkEnv(EnvBase):
    """N episodes of a task, advanced one action chunk at a time.

    One step is one decision: every environment executes the chunk's H control
    steps, or as many as its episode has left. The reward is the sum over the
    executed steps. Episodes end at the horizon, as ``truncated``; success does not
    end them, and nothing in these tasks is ``terminated``.

    Episode k of environment i starts from a state that depends only on the seed
    and on k * N + i, so that the first M episodes of a seed are the same for every
    batch size, policy and domain.

    An environment whose simulation diverges is cut off there: ``truncated`` with
    reward 0 and its last sound observation, `diverged` set, and the next reset starts
    its next episode. It is truncated rather than terminated because a broken
    simulation says nothing of the task: a value of zero would teach the policy to
    avoid, or to seek, what breaks the simulator. `divergences` counts them.

    Actions beyond [-1, 1] are clipped, the first time with a warning; ten times beyond
    it they are refused, as such numbers are in another unit.

    Args:
        task: What the task is.
        num_envs: N, the batch size.
        chunk: H, control steps a decision.
        action_size: A, dimension of an action, whose entries are in [-1, 1].
        horizon: Episode length in control steps; the task's own by default.
        seed: Draws the episodes.
        on_divergence: ``reset``, or ``raise`` a `SimulationError`.

    Attributes:
        divergences: How many simulations have diverged since construction.
        parameter_sets: Number of the domain's parameter sets, of which each episode
            draws one; 0 where it draws none.
    """

    task: TaskInfo
    #: [-1, 1] stands for the task's own range of moves; see `check_action_units`.
    scales_actions: ClassVar[bool] = True

    def __init__(
        self,
        task: TaskInfo,
        *,
        num_envs: int,
        chunk: int,
        action_size: int,
        horizon: int | None,
        seed: int,
        on_divergence: OnDivergence,
    ) -> None:
        super().__init__(device="cpu", batch_size=[num_envs])
        self.task = task
        self.chunk = chunk
        self.horizon = horizon or task.horizon
        self.divergences = 0
        self.parameter_sets = 0
        self._on_divergence = on_divergence
        self._seed = seed
        self._group_size = 1
        self._episode = np.zeros(num_envs, dtype=np.int64)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._instruction_id = np.zeros(num_envs, dtype=np.int64)
        self.action_spec = Bounded(-LIMIT, LIMIT, (num_envs, chunk, action_size))
        self._action_range = ActionRange()
        self.reward_spec = Unbounded((num_envs, 1))
        flag = Categorical(2, (num_envs, 1), dtype=torch.bool)
        self.done_spec = Composite(
            {k: flag.clone() for k in (keys.DONE, keys.TERMINATED, keys.TRUNCATED)},
            shape=(num_envs,),
        )

    def _observe_as(
        self,
        state: int,
        environment_state: int,
        image_size: tuple[int, int] | None,
        cameras: Sequence[str] = (),
    ) -> None:
        """Set the specs of what is observed; several cameras have a key each."""
        (n,) = self.batch_size
        observed: dict[str, object] = {
            "state": Unbounded((n, state)),
            "environment_state": Unbounded((n, environment_state)),
        }
        if image_size:
            frame = Bounded(0, 255, (n, 3, *image_size), dtype=torch.uint8)
            named = {name: frame.clone() for name in cameras}
            observed["image"] = (
                Composite(named, shape=(n,)) if len(named) > 1 else frame
            )
        texts = self.task.instructions
        flag = Categorical(2, (n, 1), dtype=torch.bool)
        self.observation_spec = Composite(
            {
                keys.OBSERVATION: Composite(observed, shape=(n,)),
                keys.INSTRUCTION: NonTensor((n,), example_data=texts[0]),
                keys.INSTRUCTION_ID: Categorical(len(texts), (n,), dtype=torch.int64),
                keys.SUCCESS: flag.clone(),
                keys.DIVERGED: flag.clone(),
            },
            shape=(n,),
        )

    # -- What a backend fills in -----------------------------------------------

    def _start(self, which: NDArray[np.int64], episodes: list[int]) -> None:
        """Start the episodes of these indices in the environments `which`."""
        raise NotImplementedError

    def _advance(
        self, actions: Array, steps: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Execute chunks (N, H, A); return rewards summed, (N,), and who diverged."""
        raise NotImplementedError

    def _seen(self) -> Mapping[str, torch.Tensor | TensorDict]:
        """Return the entries under `observation`."""
        raise NotImplementedError

    def _solved(self) -> NDArray[np.bool_]:
        """Return whether each environment is in a solved state, (N,)."""
        raise NotImplementedError

    # -- TorchRL's interface ---------------------------------------------------

    @property
    def states_seed(self) -> int:
        """The seed that, with an episode's number, draws its initial state."""
        return self._seed

    def parameter_set(self, index: int) -> int:
        """Return which parameter set the index-th episode of this seed draws.

        Raises:
            RlcoError: If episodes draw none.
        """
        if not self.parameter_sets:
            raise RlcoError(
                "episodes draw no parameter sets here; give make_env "
                "sample='posterior' and a domain with a sample."
            )
        rng = np.random.default_rng([self._seed, index, Stream.PARAMETER_SET])
        return int(rng.integers(self.parameter_sets))

    def _drawn_sets(self, episodes: list[int]) -> list[int] | None:
        """Return the parameter sets of episodes; None where they draw none."""
        if not self.parameter_sets:
            return None
        return [self.parameter_set(index) for index in episodes]

    def start_at(self, episode: int) -> None:
        """Let the next reset of every environment start its `episode`-th episode."""
        self._episode[:] = episode

    def start_in_groups(self, size: int) -> None:
        """Let every `size` neighbours start alike; N must be a multiple of it.

        Episode k of environment i then starts from the state number
        ``(k * N + i) // size``, with N / size of them at once.

        Raises:
            RlcoError: If N is not a multiple of the size.
        """
        (n,) = self.batch_size
        if size < 1 or n % size:
            raise RlcoError(
                f"group_size={size} does not divide num_envs={n}; give num_envs a "
                "multiple of it, as a group is episodes from one initial state."
            )
        self._group_size = size

    def _reset(
        self, tensordict: TensorDictBase | None = None, **kwargs: object
    ) -> TensorDict:
        (n,) = self.batch_size
        which: NDArray[np.int64] = np.arange(n)
        if tensordict is not None and "_reset" in tensordict:
            which = np.flatnonzero(tensordict["_reset"].numpy().reshape(n))
        episodes = ((self._episode[which] * n + which) // self._group_size).tolist()
        self._episode[which] += 1
        self._elapsed[which] = 0
        self._start(which, episodes)
        return self._result(np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        actions = tensordict.get(keys.ACTION).numpy().astype(np.float64)
        self._action_range.check(actions)
        steps = np.minimum(self.chunk, self.horizon - self._elapsed)
        reward, diverged = self._advance(actions, steps)
        self._elapsed += steps
        if diverged.any():
            self._report(diverged)
            reward = np.where(diverged, 0.0, reward)
        out = self._result((self._elapsed >= self.horizon) | diverged, diverged)
        return out.set(keys.REWARD, torch.from_numpy(reward).float().unsqueeze(-1))

    def _result(
        self, truncated: NDArray[np.bool_], diverged: NDArray[np.bool_]
    ) -> TensorDict:
        (n,) = self.batch_size
        cut = torch.from_numpy(truncated).unsqueeze(-1)
        return TensorDict(
            {
                keys.OBSERVATION: TensorDict(self._seen(), batch_size=[n]),
                keys.INSTRUCTION: self._texts(),
                keys.INSTRUCTION_ID: torch.from_numpy(self._instruction_id.copy()),
                keys.SUCCESS: torch.from_numpy(self._solved()).unsqueeze(-1),
                keys.DIVERGED: torch.from_numpy(diverged.copy()).unsqueeze(-1),
                keys.TRUNCATED: cut,
                keys.TERMINATED: torch.zeros_like(cut),
                keys.DONE: cut.clone(),
            },
            batch_size=[n],
        )

    def _texts(self) -> NonTensorStack:
        chosen = [self.task.instructions[i] for i in self._instruction_id.tolist()]
        # With a device: partial resets do not merge texts that have one with others.
        return NonTensorStack(*(NonTensorData(t, device=self.device) for t in chosen))

    def _report(self, diverged: NDArray[np.bool_]) -> None:
        broken = np.flatnonzero(diverged).tolist()
        if self._on_divergence == "raise":
            raise SimulationError(self.task.name, broken)
        if not self.divergences:
            _logger.warning(
                "%s; they are reset. Later ones are only counted, in `divergences`.",
                str(SimulationError(self.task.name, broken)).rstrip("."),
            )
        self.divergences += len(broken)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._seed = int(seed)
        self._episode[:] = 0
