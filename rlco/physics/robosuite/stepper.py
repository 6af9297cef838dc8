"""The robosuite backend: N robosuite environments that step themselves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import SimulationError
from rlco.physics.effects.corrected_model import Given
from rlco.physics.mj.model_struct import set_array
from rlco.physics.spec.domain import GivenDomain, make_domain, with_effects
from rlco.physics.spec.stepper import TOO_LARGE, OnDivergence, check_actions
from rlco.physics.spec.task import Array, InitialState, SceneState, Task


def stack_states(states: list[SceneState], axis: int = 0) -> SceneState:
    """Stack states along a new leading axis."""
    keys = vars(states[0])
    return SceneState(
        **{k: np.stack([vars(s)[k] for s in states], axis=axis) for k in keys}
    )


def keep_divergence(env: Any) -> None:
    """Keep a diverged state visible, instead of letting MuJoCo reset it."""
    options = env.sim.model._model.opt
    options.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def step_checked(env: Any, action: Array) -> tuple[bool, Any]:
    """Execute a control step; return whether the state is valid, and the result."""
    data = env.sim.data._data
    if not _is_valid(data):
        return False, None
    try:
        out = env.step(action)
    except np.linalg.LinAlgError:  # robosuite's controller inverted NaN
        return False, None
    return _is_valid(data), out


def _is_valid(data: mujoco.MjData) -> bool:
    numbers = np.concatenate([data.qpos, data.qvel])
    return bool((np.abs(numbers) < TOO_LARGE).all())


class RobosuiteStepper:
    """N worlds of robosuite's own environment, one after the other.

    The same interface as `rlco.physics.native.stepper.NativeStepper`.
    """

    def __init__(
        self,
        task: Task,
        domain: GivenDomain,
        *,
        num_envs: int,
        variation: str | None = None,
        on_divergence: OnDivergence = "raise",
        effects: Given = None,
    ) -> None:
        from rlco.physics.robosuite.tabletop import Tabletop

        self.task = task
        self.domain = with_effects(make_domain(domain), effects)
        self.num_envs = num_envs
        self._on_divergence = on_divergence
        self.envs = [
            Tabletop(task, self.domain, variation=variation) for _ in range(num_envs)
        ]
        for env in self.envs:
            keep_divergence(env)
        self.model = self.envs[0].sim.model._model
        self.data = [env.sim.data._data for env in self.envs]
        self.diverged = np.zeros(num_envs, dtype=np.bool_)
        self._present: list[SceneState] = []

    def model_of(self, number: int) -> mujoco.MjModel:
        """Return one environment's own model, to render it."""
        model: mujoco.MjModel = self.envs[number].sim.model._model
        return model

    @property
    def model_addresses(self) -> NDArray[np.int64]:
        """Addresses of the environments' models, which compiled code reads, (N,)."""
        models = [self.model_of(number) for number in range(self.num_envs)]
        return np.array([model._address for model in models], dtype=np.int64)

    def run_over(
        self, kernel: Callable[..., None], count: int, *arguments: Any
    ) -> None:
        """Run a compiled loop over `count` environments, one after the other."""
        kernel(0, count, *arguments)

    def patch(
        self, which: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
    ) -> None:
        """Give worlds their own values of arrays that only drawing reads, unchecked."""
        for row, number in enumerate(which.tolist()):
            for name, value in values.items():
                set_array(self.model_of(number), name, value[row])

    def reset(
        self,
        initial: list[InitialState],
        which: NDArray[np.int64] | None = None,
        drawn: Sequence[int] | None = None,
    ) -> SceneState:
        """Start episodes in the worlds `which`; return the state of all, (N,)."""
        which = np.arange(self.num_envs) if which is None else which
        rows = [None] * len(which) if drawn is None else drawn
        for index, start, row in zip(which.tolist(), initial, rows, strict=True):
            self.envs[index].start(start, row)
        self.diverged[which] = False
        sound = [index for index in range(self.num_envs) if not self.diverged[index]]
        fresh = {index: self.envs[index].scene_state() for index in sound}
        self._present = [
            fresh[index] if index in fresh else self._present[index]
            for index in range(self.num_envs)
        ]
        return self.scene_state()

    def step(
        self, actions: Array, steps: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Execute action chunks (N, H, A); return states (N, H + 1).

        Raises:
            RlcoError: If an action is NaN or infinite.
            SimulationError: If a world diverges, unless such worlds are marked.
        """
        check_actions(actions)
        count, horizon, _ = actions.shape
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        rows = []
        for index, env in enumerate(self.envs):
            states = [self._present[index]]
            for t in range(horizon):
                if t < steps[index] and not self.diverged[index]:
                    sound, _ = step_checked(env, actions[index, t])
                    self.diverged[index] = not sound
                    if sound:
                        self._present[index] = env.scene_state()
                states.append(self._present[index])
            rows.append(stack_states(states))
        if self._on_divergence == "raise" and self.diverged.any():
            broken = np.flatnonzero(self.diverged).tolist()
            raise SimulationError(self.task.name, broken)
        return stack_states(rows)

    def scene_state(self) -> SceneState:
        """Return the current state of all worlds, leading axes (N,)."""
        return stack_states(self._present)

    def reported_state(self) -> SceneState:
        """Return the same, with robots as their encoders report them."""
        return stack_states(
            [
                present if broken else env.reported_state()
                for present, env, broken in zip(
                    self._present, self.envs, self.diverged, strict=True
                )
            ]
        )
