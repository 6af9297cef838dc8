"""Any one-armed robosuite task: N worlds stepped without robosuite's Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, SimulationError
from rlco.physics.native.kernels import (
    advance_range,
    clear_range,
    forward_range,
    set_first_matrices,
)
from rlco.physics.native.worlds import Worlds
from rlco.physics.robosuite.effect_sim import corrected_model_of, drawn_models_of
from rlco.physics.robosuite.global_random import peeked_seed, seed_all, seeded
from rlco.physics.robosuite.read_control import read_control, read_gains
from rlco.physics.robosuite.source import Cache, RobosuiteSource
from rlco.physics.spec.control import Array
from rlco.physics.spec.stepper import BatchStep, OnDivergence, check_actions


class RobosuiteBatch:
    """N worlds of a robosuite environment: its model, resets, rewards, observations.

    The physics and the controller (``OSC_POSE`` or ``JOINT_POSITION`` of one arm on a
    fixed base) run compiled, in threads. Object placement, reward, success and
    observations are robosuite's own Python, run on each world's state.

    An episode of seed s starts where robosuite's ``env.reset()`` would start it after
    ``numpy.random.seed(s)`` and ``random.seed(s)``.

    Args:
        env: A robosuite environment, which is taken over, or a function that makes
            one; with ``hard_reset=False`` and ``use_camera_obs=False``.
        num_envs: Number of worlds N.
        threads: Python threads; by default one per core, at most `num_envs`.
        exact: Compute torques with robosuite's own linear algebra, see
            `rlco.physics.native.stepper.NativeStepper`.
        observations: Names of the requested ones (``object-state``); None: all.
        rewards: Whether to compute rewards; otherwise they are 0.
        on_divergence: ``raise``, or ``mark`` a world that diverges and stop stepping it
            until its reset; its observations stay at the last valid ones.

    Raises:
        RlcoError: If the environment has an unsupported feature, which is named.

    Example:
        >>> from rlco.physics.robosuite.tasks import make_plain
        >>> batch = RobosuiteBatch(make_plain("Lift"), num_envs=2, threads=1)
        >>> batch.reset([1, 2])["cube_pos"].shape
        (2, 3)
        >>> batch.step(np.zeros((2, 4, batch.action_size))).reward.shape
        (2, 4)
    """

    def __init__(
        self,
        env: Any | Callable[[], Any],
        *,
        num_envs: int,
        threads: int | None = None,
        exact: bool = False,
        observations: Sequence[str] | None = None,
        rewards: bool = True,
        on_divergence: OnDivergence = "raise",
    ) -> None:
        made = env() if callable(env) else env
        self.source = RobosuiteSource(made, observations)
        self.name = type(made).__name__
        self.num_envs = num_envs
        self._rewards = rewards
        self._on_divergence = on_divergence
        self.worlds = Worlds(
            self.source.model,
            read_control(made, exact=exact),
            read_gains(made),
            num_envs=num_envs,
            threads=threads,
            controller_model=corrected_model_of(made.sim).controller_model,
            drawn=drawn_models_of(made.sim),
        )
        self._caches: list[Cache] = [{} for _ in range(num_envs)]
        self.source.look_at(self.data[0])
        width = self.source.observe({}).size
        self._values: Array = np.zeros((num_envs, width))
        self._success = np.zeros(num_envs, dtype=np.bool_)

    @property
    def action_size(self) -> int:
        """Size of an action: of the arm, then of the gripper."""
        return self.worlds.control.action_size

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of all worlds."""
        return self.worlds.model

    @property
    def data(self) -> list[mujoco.MjData]:
        """MuJoCo's state of each world."""
        return self.worlds.data

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Mask of the worlds that have diverged since their reset, shape (N,)."""
        return self.worlds.memory.broken

    @property
    def success(self) -> NDArray[np.bool_]:
        """Robosuite's success check of the current state, shape (N,)."""
        return self._success.copy()

    def reset(
        self,
        seeds: Sequence[int],
        which: NDArray[np.int64] | None = None,
        drawn: Sequence[int] | None = None,
    ) -> dict[str, Array]:
        """Start episodes in the worlds `which` (all by default).

        Args:
            seeds: One for each of `which`, in [0, 2**32).
            which: Indices of worlds, shape (R,).
            drawn: The parameter set that each of `which` has from now on; None: the
                last one, or at first the effects' own numbers.

        Returns:
            The observations of all worlds.
        """
        which = np.arange(self.num_envs) if which is None else which
        if drawn is not None:
            self.worlds.draw(which, drawn)
        memory, source = self.worlds.memory, self.source
        self.worlds.forget(which)
        clear_range(which, memory)
        with seeded():  # only to restore the generators, whatever the seed
            for number, seed in zip(which.tolist(), seeds, strict=True):
                source.look_at(self.data[number])
                if self.worlds.control_of(number).acting.random.size:
                    seed_all(seed)
                    memory.seed[number] = peeked_seed()
                source.place(seed)
                self._take_over(number)
        if not self.worlds.control.acting.controller_model:
            set_first_matrices(which, self.worlds.control, memory, self.model.qpos0)
        forward_range(which, memory)
        for number in which.tolist():
            self._look(number)
            self._measure(number)
        return self.observations()

    def step(self, actions: Array, steps: NDArray[np.int64] | None = None) -> BatchStep:
        """Execute action chunks, shape (N, H, A), in all worlds.

        Args:
            actions: Values outside the controllers' input range are clipped.
            steps: Number of the H steps that each world executes, shape (N,); all by
                default.

        Raises:
            RlcoError: If an action is NaN or infinite, or A is wrong.
            SimulationError: If a world diverges, unless such worlds are marked.
        """
        check_actions(actions)
        count, horizon, size = actions.shape
        if size != self.action_size:
            raise RlcoError(
                f"actions have size {size}; {self.name} takes {self.action_size}."
            )
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        actions = np.ascontiguousarray(actions, dtype=np.float64)
        reward = np.zeros((count, horizon))
        # robosuite's Python is needed after each control step, or only at the end.
        stride = 1 if self._rewards or self.source.lags else horizon
        for first in range(0, horizon, stride):
            left = np.clip(steps - first, 0, stride)
            part = np.ascontiguousarray(actions[:, first : first + stride])
            self.worlds.run_controlled(advance_range, part, left)
            self._settle(left, steps - first <= stride, part, reward[:, first])
        if self._on_divergence == "raise" and self.diverged.any():
            raise SimulationError(self.name, np.flatnonzero(self.diverged).tolist())
        return BatchStep(
            self.observations(), reward, self.success, self.diverged.copy()
        )

    def observations(self) -> dict[str, Array]:
        """Return the current observations of all worlds, each shape (N, K)."""
        return {k: self._values[:, at] for k, at in self.source.columns.items()}

    def randomise(
        self,
        which: NDArray[np.int64] | Sequence[int],
        fields: Mapping[str, NDArray[Any]] | None = None,
        *,
        stiffness: NDArray[Any] | float | None = None,
        damping: NDArray[Any] | float | None = None,
        command_delay: NDArray[Any] | int | None = None,
    ) -> None:
        """Change only the worlds `which`; see `rlco.physics.native.worlds.Worlds`.

        Resets keep the change, except for arrays that the task's own reset writes.

        Raises:
            RlcoError: If a name, a shape or a value is not allowed.
        """
        self.worlds.randomise(
            which,
            fields,
            stiffness=stiffness,
            damping=damping,
            command_delay=command_delay,
        )

    def _take_over(self, number: int) -> None:
        """Store what robosuite has just placed as one world's initial state."""
        source, memory = self.source, self.worlds.memory
        if source.reset_fields:
            values = {n: getattr(source.model, n) for n in source.reset_fields}
            if self.worlds.draws:
                values = self._beside_drawn(number, values)
            rows = {name: value[None] for name, value in values.items()}
            self.worlds.patch_model(np.array([number]), rows, derive=False)
        posture = self.data[number].qpos[self.worlds.control.arm_qpos]
        memory.posture[number] = posture
        memory.grip[number] = 0.0
        self._caches[number] = {}

    def _beside_drawn(
        self, number: int, values: Mapping[str, NDArray[Any]]
    ) -> dict[str, NDArray[Any]]:
        """Return what a reset wrote, and the world's parameter set for all the rest."""
        own, common = self.worlds.model_of(number), self.model
        return {
            name: np.where(value == getattr(common, name), getattr(own, name), value)
            for name, value in values.items()
        }

    def _settle(
        self,
        executed: NDArray[np.int64],
        last: NDArray[np.bool_],
        actions: Array,
        reward: Array,
    ) -> None:
        """Run robosuite's Python on the worlds that have moved."""
        for number in np.flatnonzero((executed > 0) & ~self.diverged).tolist():
            self._look(number)
            if self._rewards:
                reward[number] = self.source.env.reward(actions[number, 0])
            if last[number] or self.source.lags:
                self._measure(number)

    def _look(self, number: int) -> None:
        self.source.look_at(self.data[number])

    def _measure(self, number: int) -> None:
        self._values[number] = self.source.observe(self._caches[number])
        self._success[number] = bool(self.source.env._check_success())
