"""The robosuite backend: N robosuite environments that step themselves."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import SimulationError
from rlco.physics.domain import Domain
from rlco.physics.task import Array, InitialState, SceneState, Task, check_actions


def stack_states(states: list[SceneState], axis: int = 0) -> SceneState:
    """Stack states along a new leading axis."""
    keys = vars(states[0])
    return SceneState(
        **{k: np.stack([vars(s)[k] for s in states], axis=axis) for k in keys}
    )


class RobosuiteStepper:
    """N copies of robosuite's own environment, one after the other.

    The same interface as `rlco.physics.native.NativeStepper`.
    """

    def __init__(self, task: Task, domain: Domain, *, num_envs: int) -> None:
        from rlco.physics.tabletop import Tabletop

        self.task = task
        self.domain = domain
        self.num_envs = num_envs
        self.envs = [Tabletop(task, domain) for _ in range(num_envs)]
        for env in self.envs:
            # A diverged state must show as NaN, not start over from the model's zero.
            flags = env.sim.model._model.opt
            flags.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = self.envs[0].sim.model._model
        self.data = [env.sim.data._data for env in self.envs]

    def reset(
        self, initial: list[InitialState], which: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Start episodes in the copies `which`; return the state of all, (N,)."""
        which = np.arange(self.num_envs) if which is None else which
        for index, start in zip(which.tolist(), initial, strict=True):
            self.envs[index].start(start)
        return self.scene_state()

    def step(
        self, actions: Array, steps: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Execute action chunks (N, H, 7); return states (N, H + 1).

        Raises:
            RlcoError: If an action is NaN or infinite.
            SimulationError: If a copy diverges.
        """
        check_actions(actions)
        count, horizon, _ = actions.shape
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        rows, broken = [], []
        for index, env in enumerate(self.envs):
            states = [env.scene_state()]
            try:
                for t in range(horizon):
                    if t < steps[index]:
                        env.step(actions[index, t])
                    states.append(env.scene_state())
            except np.linalg.LinAlgError:  # robosuite's controller inverted NaN
                broken.append(index)
                continue
            rows.append(stack_states(states))
            if not np.isfinite(env.sim.data._data.qpos).all():
                broken.append(index)
        if broken:
            raise SimulationError(self.task.name, broken)
        return stack_states(rows)

    def scene_state(self) -> SceneState:
        """Return the present state of all copies, leading axes (N,)."""
        return stack_states([env.scene_state() for env in self.envs])
