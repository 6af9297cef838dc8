"""N robosuite environments that step themselves: `RobosuiteBatch` with robosuite."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlco.errors import SimulationError
from rlco.physics.robosuite.global_random import seeded
from rlco.physics.robosuite.stepper import keep_divergence, step_checked
from rlco.physics.spec.control import Array
from rlco.physics.spec.stepper import BatchStep, OnDivergence, check_actions


class RobosuiteEnvs:
    """N of robosuite's own environments, one after the other.

    The same interface as `rlco.physics.native.robosuite_batch.RobosuiteBatch`.

    Args:
        make: Creates one; each must have the same model.
        num_envs: Number of environments N.
        observations: Names of the requested ones; None: all.
        on_divergence: ``raise``, or ``mark`` an environment that diverges and stop
            stepping it until its reset.
    """

    def __init__(
        self,
        make: Callable[[], Any],
        *,
        num_envs: int,
        observations: Sequence[str] | None = None,
        on_divergence: OnDivergence = "raise",
    ) -> None:
        self.envs = [make() for _ in range(num_envs)]
        for env in self.envs:
            keep_divergence(env)
        self.name = type(self.envs[0]).__name__
        self.num_envs = num_envs
        self._observations = observations
        self._on_divergence = on_divergence
        self._last_observations: list[dict[str, Array]] = [{} for _ in range(num_envs)]
        self.success = np.zeros(num_envs, dtype=np.bool_)
        self.diverged = np.zeros(num_envs, dtype=np.bool_)

    @property
    def action_size(self) -> int:
        """Size of an action."""
        return int(self.envs[0].action_dim)

    @property
    def data(self) -> list[Any]:
        """MuJoCo's state of each environment."""
        return [env.sim.data._data for env in self.envs]

    def reset(
        self,
        seeds: Sequence[int],
        which: NDArray[np.int64] | None = None,
        drawn: Sequence[int] | None = None,
    ) -> dict[str, Array]:
        """Start episodes in the environments `which` (all by default)."""
        which = np.arange(self.num_envs) if which is None else which
        rows = [None] * len(which) if drawn is None else drawn
        for index, seed, row in zip(which.tolist(), seeds, rows, strict=True):
            if row is not None:
                self.envs[index].sim.draw(row)
            with seeded(seed):
                self._take(index, self.envs[index].reset())
        self.diverged[which] = False
        return self.observations()

    def step(self, actions: Array, steps: NDArray[np.int64] | None = None) -> BatchStep:
        """Execute action chunks, shape (N, H, A).

        Raises:
            RlcoError: If an action is NaN or infinite.
            SimulationError: If an environment diverges, unless such ones are marked.
        """
        check_actions(actions)
        count, horizon, _ = actions.shape
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        reward = np.zeros((count, horizon))
        for index, env in enumerate(self.envs):
            for t in range(steps[index]):
                if self.diverged[index]:
                    break
                sound, out = step_checked(env, actions[index, t])
                self.diverged[index] = not sound
                if sound:
                    reward[index, t] = out[1]
                    self._take(index, out[0])
        if self._on_divergence == "raise" and self.diverged.any():
            raise SimulationError(self.name, np.flatnonzero(self.diverged).tolist())
        return BatchStep(
            self.observations(), reward, self.success.copy(), self.diverged.copy()
        )

    def observations(self) -> dict[str, Array]:
        """Return the current observations of all environments, each shape (N, K)."""
        return {
            k: np.stack([observation[k] for observation in self._last_observations])
            for k in self._last_observations[0]
        }

    def _take(self, index: int, observation: dict[str, Any]) -> None:
        names = self._observations or list(observation)
        self._last_observations[index] = {
            k: np.ravel(observation[k]).astype(np.float64) for k in names
        }
        self.success[index] = bool(self.envs[index]._check_success())
