"""A batch of robosuite tasks as one TorchRL environment."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NonTensorData, NonTensorStack, TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, NonTensor, Unbounded
from torchrl.envs import EnvBase

from rlco import keys
from rlco.physics.camera import Camera
from rlco.physics.domain import Domain
from rlco.physics.observation import STATE_NAMES, noise_size, observe
from rlco.physics.task import Array, InitialState, SceneState, Task

RewardKind = Literal["shaped", "sparse"]


class Stepper(Protocol):
    """What a backend offers: N copies of a task's model."""

    model: object
    data: list[object]

    def reset(
        self, initial: list[InitialState], which: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Start episodes in the copies `which`; return all states, (N,)."""

    def step(
        self, actions: Array, steps: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Execute chunks (N, H, 7); return states (N, H + 1)."""


class TabletopEnv(EnvBase):
    """N episodes of a task, advanced one action chunk at a time.

    One step is one decision: every environment executes the chunk's H control
    steps, or as many as its episode has left. The reward is the sum over the
    executed steps. Episodes end at the horizon, as ``truncated``; success does not
    end them, and nothing in these tasks is ``terminated``.

    Episode k of environment i starts from a state that depends only on the seed
    and on k * N + i, so that the first M episodes of a seed are the same for every
    batch size, policy and domain.

    Args:
        task: The task.
        domain: What differs from the simulator as built.
        stepper: The backend's copies.
        num_envs: N, the batch size.
        chunk: H, control steps a decision.
        reward: ``shaped`` or ``sparse``.
        horizon: Episode length in control steps; the task's own by default.
        image_size: Height and width of camera frames; None: no images.
        variation: A named variation of the task's initial states.
        seed: Draws initial states and sensor noise.
    """

    def __init__(
        self,
        task: Task,
        domain: Domain,
        stepper: Stepper,
        *,
        num_envs: int,
        chunk: int,
        reward: RewardKind,
        horizon: int | None,
        image_size: tuple[int, int] | None,
        variation: str | None,
        seed: int,
    ) -> None:
        super().__init__(device="cpu", batch_size=[num_envs])
        self.task = task
        self.domain = domain
        self.stepper = stepper
        self.chunk = chunk
        self.horizon = horizon or task.horizon
        self._reward_kind = reward
        self._variation = variation
        self._camera = Camera(stepper.model, image_size) if image_size else None
        self._image_size = image_size
        self._seed = seed
        self._episode = np.zeros(num_envs, dtype=np.int64)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        # One row of sensor noise for the start and for each decision of an episode.
        self._decisions = -(-self.horizon // chunk)
        self._noise = np.zeros((num_envs, self._decisions + 1, noise_size(task)))
        self._texts = [task.instructions[0]] * num_envs
        self._make_specs()

    def _make_specs(self) -> None:
        (n,) = self.batch_size
        observation: dict[str, object] = {
            "state": Unbounded((n, len(STATE_NAMES))),
            "environment_state": Unbounded((n, len(self.task.environment_state_names))),
        }
        if self._image_size:
            shape = (n, 3, *self._image_size)
            observation["image"] = Bounded(0, 255, shape, dtype=torch.uint8)
        count = len(self.task.instructions)
        self.observation_spec = Composite(
            {
                keys.OBSERVATION: Composite(observation, shape=(n,)),
                keys.INSTRUCTION: NonTensor(
                    (n,), example_data=self.task.instructions[0]
                ),
                keys.INSTRUCTION_ID: Categorical(count, (n,), dtype=torch.int64),
                keys.SUCCESS: Categorical(2, (n, 1), dtype=torch.bool),
            },
            shape=(n,),
        )
        self.action_spec = Bounded(-1.0, 1.0, (n, self.chunk, 7))
        self.reward_spec = Unbounded((n, 1))
        flag = Categorical(2, (n, 1), dtype=torch.bool)
        self.done_spec = Composite(
            {k: flag.clone() for k in (keys.DONE, keys.TERMINATED, keys.TRUNCATED)},
            shape=(n,),
        )

    def start_at(self, episode: int) -> None:
        """Let the next reset of every environment start its `episode`-th episode."""
        self._episode[:] = episode

    def initial_state(self, index: int) -> InitialState:
        """Return how the index-th episode of this environment's seed starts."""
        rng = np.random.default_rng([self._seed, index])
        return self.task.sample(rng, self._variation)

    def _reset(
        self, tensordict: TensorDictBase | None = None, **kwargs: object
    ) -> TensorDict:
        (n,) = self.batch_size
        mask = np.ones(n, dtype=bool)
        if tensordict is not None and "_reset" in tensordict:
            mask = tensordict["_reset"].numpy().reshape(n)
        which = np.flatnonzero(mask)
        episodes = (self._episode[which] * n + which).tolist()
        starts = [self.initial_state(index) for index in episodes]
        for env, index in zip(which.tolist(), episodes, strict=True):
            # Its own stream, so that noise never shifts the initial states.
            rng = np.random.default_rng([self._seed, index, 1])
            self._noise[env] = rng.standard_normal(self._noise.shape[1:])
        self._episode[which] += 1
        self._elapsed[which] = 0
        state = self.stepper.reset(starts, which)
        self._texts = [self.task.instructions[i] for i in state.instruction_id.tolist()]
        out = self._observation(state)
        no = torch.zeros(n, 1, dtype=torch.bool)
        for key in (keys.DONE, keys.TERMINATED, keys.TRUNCATED):
            out.set(key, no.clone())
        return out

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        actions = tensordict.get(keys.ACTION).numpy().astype(np.float64)
        steps = np.minimum(self.chunk, self.horizon - self._elapsed)
        states = self.stepper.step(actions, steps)
        rewards = self.task.reward(
            states.at(np.s_[:, :-1]), states.at(np.s_[:, 1:]), self._reward_kind
        )
        executed = np.arange(self.chunk) < steps[:, None]
        self._elapsed += steps
        out = self._observation(states.at(np.s_[:, -1]))
        reward = np.where(executed, rewards, 0.0).sum(axis=1)
        out.set(keys.REWARD, torch.from_numpy(reward).float().unsqueeze(-1))
        truncated = torch.from_numpy(self._elapsed >= self.horizon).unsqueeze(-1)
        out.set(keys.TRUNCATED, truncated)
        out.set(keys.TERMINATED, torch.zeros_like(truncated))
        out.set(keys.DONE, truncated.clone())
        return out

    def _observation(self, state: SceneState) -> TensorDict:
        (n,) = self.batch_size
        row = -(-self._elapsed // self.chunk)
        noise = self._noise[np.arange(n), row]
        robot, environment = observe(self.task, self.domain, state, noise)
        seen = {
            "state": torch.from_numpy(robot).float(),
            "environment_state": torch.from_numpy(environment).float(),
        }
        if self._camera is not None:
            frames = [self._camera.frame(data) for data in self.stepper.data]
            seen["image"] = torch.from_numpy(np.stack(frames))
        success = torch.from_numpy(self.task.success(state)).unsqueeze(-1)
        ids = torch.from_numpy(state.instruction_id.copy())
        return TensorDict(
            {
                keys.OBSERVATION: TensorDict(seen, batch_size=[n]),
                keys.INSTRUCTION: NonTensorStack(*map(NonTensorData, self._texts)),
                keys.INSTRUCTION_ID: ids,
                keys.SUCCESS: success,
            },
            batch_size=[n],
        )

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the rendering context too."""
        if self._camera is not None:
            self._camera.close()
        super().close(raise_if_closed=raise_if_closed)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._seed = int(seed)
        self._episode[:] = 0
