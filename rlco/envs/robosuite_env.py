"""robosuite's own tasks as one TorchRL environment, under rlco's keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from rlco.envs.chunk_env import ChunkEnv, OnDivergence, RewardKind
from rlco.errors import RlcoError
from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.native.robosuite_batch import RobosuiteBatch
from rlco.physics.robosuite.envs import RobosuiteEnvs
from rlco.physics.robosuite.options import check_one_arm, check_options
from rlco.physics.robosuite.tasks import (
    ENVIRONMENT_STATE,
    STATE,
    RobosuiteTask,
    make_plain,
)
from rlco.physics.spec.control import Array
from rlco.physics.spec.sample import Sample
from rlco.physics.spec.stepper import BatchStep

# Options that `make_env` has by another name, or of another kind.
_OURS = {
    "reward_shaping": "give reward='shaped' or reward='sparse'",
    "effects": "give effects= of make_env itself",
}


class Batch(Protocol):
    """What a backend offers: N worlds of a robosuite environment."""

    @property
    def action_size(self) -> int:
        """Numbers in an action."""

    @property
    def success(self) -> NDArray[np.bool_]:
        """Robosuite's check of the present state, shape (N,)."""

    def reset(
        self,
        seeds: list[int],
        which: NDArray[np.int64],
        drawn: Sequence[int] | None = None,
    ) -> dict[str, Array]:
        """Start episodes in the worlds `which`; return all observations."""

    def step(self, actions: Array, steps: NDArray[np.int64]) -> BatchStep:
        """Execute chunks (N, H, A)."""

    def observations(self) -> dict[str, Array]:
        """Return the present observations, each shape (N, K)."""


class RobosuiteEnv(ChunkEnv):
    """N episodes of a robosuite task; see `ChunkEnv` for how they advance.

    ``("observation", "state")`` is the tool's position [m] and orientation (x, y, z,
    w) in the world frame and the joints of the gripper, named by `task.state_names`;
    ``("observation", "environment_state")`` robosuite's ``object-state``. The reward
    is robosuite's own, with ``reward_shaping=True`` for ``shaped``.

    Args:
        task: The task.
        backend: The worlds, which mark those that diverge.
        num_envs: N, the batch size.
        chunk: H, control steps a decision.
        horizon: Episode length in control steps; the task's own by default.
        seed: Draws initial states.
        on_divergence: ``reset`` or ``raise``.
        sets: Number of parameter sets, of which each episode draws one; 0: none.
    """

    task: RobosuiteTask

    def __init__(
        self,
        task: RobosuiteTask,
        backend: Batch,
        *,
        num_envs: int,
        chunk: int,
        horizon: int | None,
        seed: int,
        on_divergence: OnDivergence = "reset",
        sets: int = 0,
    ) -> None:
        super().__init__(
            task,
            num_envs=num_envs,
            chunk=chunk,
            action_size=backend.action_size,
            horizon=horizon,
            seed=seed,
            on_divergence=on_divergence,
        )
        self.backend = backend
        self.parameter_sets = sets
        self._start(np.arange(num_envs), list(range(num_envs)))
        observed = self._seen()
        self._observe_as(
            observed["state"].shape[1], observed["environment_state"].shape[1], None
        )

    def episode_seed(self, index: int) -> int:
        """Return the seed of robosuite's draws in the index-th episode."""
        return int(np.random.SeedSequence([self._seed, index]).generate_state(1)[0])

    def _start(self, which: NDArray[np.int64], episodes: list[int]) -> None:
        seeds = [self.episode_seed(index) for index in episodes]
        self.backend.reset(seeds, which, self._drawn_sets(episodes))

    def _advance(
        self, actions: Array, steps: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.bool_]]:
        out = self.backend.step(actions, steps)
        return out.reward.sum(axis=1), out.diverged

    def _seen(self) -> dict[str, torch.Tensor]:
        found = self.backend.observations()
        state = np.concatenate([found[name] for name in STATE], axis=1)
        return {
            "state": torch.from_numpy(state).float(),
            "environment_state": torch.from_numpy(found[ENVIRONMENT_STATE]).float(),
        }

    def _solved(self) -> NDArray[np.bool_]:
        return self.backend.success.copy()


def make_robosuite_env(
    name: str,
    *,
    backend: str,
    num_envs: int,
    chunk: int,
    reward: RewardKind,
    horizon: int | None,
    seed: int,
    threads: int | None,
    exact: bool,
    on_divergence: OnDivergence,
    options: Mapping[str, Any],
    effects: EffectsFile | None = None,
    sample: Sample | None = None,
) -> RobosuiteEnv:
    """Return a robosuite task as a TorchRL environment; see `rlco.envs.make_env`.

    Raises:
        UnknownNameError: If robosuite has no such environment, option or robot.
        RlcoError: If it has more than one arm, or an option is `make_env`'s own.
    """
    check_one_arm(name)
    for option, advice in _OURS.items():
        if option in options:
            given = {option: options[option]}
            raise RlcoError(f"robosuite_options={given!r} is not allowed; {advice}.")
    check_options(name, options)

    def make() -> Any:
        shaped = reward == "shaped"
        return make_plain(
            name, effects=effects, sample=sample, reward_shaping=shaped, **options
        )

    wanted = [*STATE, ENVIRONMENT_STATE]
    first = make()
    task = RobosuiteTask.of(name, first)
    batch: Batch
    if backend == "native":
        batch = RobosuiteBatch(
            first,
            num_envs=num_envs,
            threads=threads,
            exact=exact,
            observations=wanted,
            on_divergence="mark",
        )
    else:
        envs = iter([first])
        batch = RobosuiteEnvs(
            lambda: next(envs, None) or make(),
            num_envs=num_envs,
            observations=wanted,
            on_divergence="mark",
        )
    return RobosuiteEnv(
        task,
        batch,
        num_envs=num_envs,
        chunk=chunk,
        horizon=horizon,
        seed=seed,
        on_divergence=on_divergence,
        sets=0 if sample is None else len(sample),
    )
