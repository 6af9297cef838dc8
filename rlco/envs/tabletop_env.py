"""rlco's own tasks as one TorchRL environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from rlco.envs.chunk_env import ChunkEnv, OnDivergence, RewardKind
from rlco.physics.rendering.camera import Quality
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.stepper import Stepper
from rlco.physics.spec.streams import Stream
from rlco.physics.spec.task import Array, InitialState, SceneState, Task
from rlco.physics.tasks.views import Views


class TabletopEnv(ChunkEnv):
    """N episodes of one of rlco's tasks; see `ChunkEnv` for how they advance.

    Args:
        task: The task.
        domain: What differs from the simulator as built; each episode draws one of its
            parameter sets, where it has any.
        stepper: The backend's worlds, which mark those that diverge.
        num_envs: N, the batch size.
        chunk: H, control steps a decision.
        reward: ``shaped`` or ``sparse``.
        horizon: Episode length in control steps; the task's own by default.
        image_size: Height and width of camera frames; None: no images.
        image_quality: Of ``opengl``: ``fast`` or ``robosuite``.
        renderer: ``raster`` or ``opengl``.
        variation: A named variation of the task's initial states.
        seed: Draws initial states and sensor noise.
        on_divergence: ``reset`` or ``raise``.
        cameras: Names of the cameras, all of one size.
    """

    task: Task

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
        image_quality: Quality,
        variation: str | None,
        seed: int,
        on_divergence: OnDivergence = "reset",
        renderer: Renderer = "opengl",
        cameras: Sequence[str] = ("agentview",),
    ) -> None:
        super().__init__(
            task,
            num_envs=num_envs,
            chunk=chunk,
            action_size=len(task.action_names),
            horizon=horizon,
            seed=seed,
            on_divergence=on_divergence,
        )
        self.domain = domain
        self.parameter_sets = 0 if domain.sample is None else len(domain.sample)
        self.stepper = stepper
        self._reward_kind = reward
        self._variation = variation
        self._views: Views | None = None
        if image_size is not None:
            self._views = Views(
                stepper,
                domain.look,
                image_size,
                cameras=cameras,
                renderer=renderer,
                quality=image_quality,
            )
        # One row of sensor noise for the start and for each decision of an episode.
        decisions = -(-self.horizon // chunk)
        self._noise = np.zeros((num_envs, decisions + 1, noise_size(task)))
        self._state: SceneState | None = None
        self._observe_as(
            len(task.state_names),
            len(task.environment_state_names),
            image_size,
            cameras,
        )

    def initial_state(self, index: int) -> InitialState:
        """Return how the index-th episode of this environment's seed starts."""
        rng = np.random.default_rng([self._seed, index])
        return self.task.initial_state(rng, self._variation)

    def _start(self, which: NDArray[np.int64], episodes: list[int]) -> None:
        starts = [self.initial_state(index) for index in episodes]
        for env, index in zip(which.tolist(), episodes, strict=True):
            rng = np.random.default_rng([self._seed, index, Stream.NOISE])
            self._noise[env] = rng.standard_normal(self._noise.shape[1:])
        if self._views is not None:
            self._views.start(which, self._seed, episodes)
        self._state = self.stepper.reset(starts, which, self._drawn_sets(episodes))
        self._instruction_id[:] = self._state.instruction_id
        self._render(which, np.zeros_like(self._elapsed))

    def _advance(
        self, actions: Array, steps: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.bool_]]:
        states = self.stepper.step(actions, steps)
        rewards = self.task.reward(
            states.at(np.s_[:, :-1]), states.at(np.s_[:, 1:]), self._reward_kind
        )
        self._state = states.at(np.s_[:, -1])
        diverged = self.stepper.diverged
        self._render(np.flatnonzero((steps > 0) & ~diverged), steps)
        executed = np.arange(self.chunk) < steps[:, None]
        return np.where(executed, rewards, 0.0).sum(axis=1), diverged

    def _render(self, which: NDArray[np.int64], steps: NDArray[np.int64]) -> None:
        """Renew the frames of the worlds that have moved, by so many steps (N,)."""
        if self._views is not None:
            self._views.draw(which, self._elapsed + steps)

    def _seen(self) -> Mapping[str, torch.Tensor | TensorDict]:
        row = -(-self._elapsed // self.chunk)
        noise = self._noise[np.arange(row.size), row]
        reported = self.stepper.reported_state()
        robot, environment = observe(self.task, self.domain, reported, noise)
        observed: dict[str, torch.Tensor | TensorDict] = {
            "state": torch.from_numpy(robot).float(),
            "environment_state": torch.from_numpy(environment).float(),
        }
        if self._views is not None:
            images = {
                name: torch.from_numpy(frames.copy())
                for name, frames in self._views.images.items()
            }
            (first, *more) = images.values()
            observed["image"] = (
                TensorDict(images, batch_size=self.batch_size) if more else first
            )
        return observed

    def _solved(self) -> NDArray[np.bool_]:
        return self.task.success(self._present)

    @property
    def _present(self) -> SceneState:
        if self._state is None:
            raise RuntimeError("call reset() before step()")
        return self._state

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the rendering context too."""
        if self._views is not None:
            self._views.close()
        super().close(raise_if_closed=raise_if_closed)
