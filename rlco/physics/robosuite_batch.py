"""Any one-armed robosuite task: N copies stepped without robosuite's Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, SimulationError
from rlco.physics.arm_control import Array, read_control, read_gains
from rlco.physics.copies import Copies
from rlco.physics.effect_sim import mended_model_of
from rlco.physics.global_random import seeded
from rlco.physics.native import OnDivergence
from rlco.physics.native_kernels import (
    advance_range,
    clear_range,
    forward_range,
    set_first_matrices,
)
from rlco.physics.robosuite_source import Cache, RobosuiteSource
from rlco.physics.task import check_actions


@dataclass(frozen=True)
class BatchStep:
    """What came of one action chunk in N copies.

    Attributes:
        observations: robosuite's, by name, each shape (N, K).
        reward: Of each control step, shape (N, H); 0 where none was executed.
        success: robosuite's check of the present state, shape (N,).
        diverged: Which copies have diverged since their reset, shape (N,).
    """

    observations: dict[str, Array]
    reward: Array
    success: NDArray[np.bool_]
    diverged: NDArray[np.bool_]


class RobosuiteBatch:
    """N copies of a robosuite environment: its model, resets, rewards, observations.

    The physics and the controller (``OSC_POSE`` or ``JOINT_POSITION`` of one arm on a
    fixed base) run compiled, in threads; placing objects, reward, success and
    observations are robosuite's own Python, run on each copy's state.

    An episode of seed s starts where robosuite's ``env.reset()`` would start it after
    ``numpy.random.seed(s)`` and ``random.seed(s)``.

    Args:
        env: A robosuite environment, which is taken over, or a function that makes
            one; with ``hard_reset=False`` and ``use_camera_obs=False``.
        num_envs: Number of copies N.
        threads: Python threads; by default one a core, at most `num_envs`.
        exact: Compute torques with robosuite's own linear algebra, see
            `rlco.physics.native.NativeStepper`.
        observations: Names of those wanted (``object-state``); None: all.
        rewards: Whether to compute rewards; without, they are 0.
        on_divergence: ``raise``, or ``mark`` a copy that diverges and leave it alone
            until its reset; its observations stay the last sound ones.

    Raises:
        RlcoError: If the environment has something that is not supported; names it.

    Example:
        >>> from rlco.physics.robosuite_tasks import make_plain
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
        self.copies = Copies(
            self.source.model,
            read_control(made, exact=exact),
            read_gains(made),
            num_envs=num_envs,
            threads=threads,
            believed=mended_model_of(made.sim).believed,
        )
        self._caches: list[Cache] = [{} for _ in range(num_envs)]
        self.source.look_at(self.data[0])
        width = self.source.observe({}).size
        self._values: Array = np.zeros((num_envs, width))
        self._success = np.zeros(num_envs, dtype=np.bool_)

    @property
    def action_size(self) -> int:
        """Numbers in an action: of the arm, then of the gripper."""
        return self.copies.control.action_size

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of all copies."""
        return self.copies.model

    @property
    def data(self) -> list[mujoco.MjData]:
        """MuJoCo's state of each copy."""
        return self.copies.data

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Which copies have diverged since their reset, shape (N,)."""
        return self.copies.memory.broken

    @property
    def success(self) -> NDArray[np.bool_]:
        """Robosuite's check of the present state, shape (N,)."""
        return self._success.copy()

    def reset(
        self, seeds: Sequence[int], which: NDArray[np.int64] | None = None
    ) -> dict[str, Array]:
        """Start episodes in the copies `which` (all by default).

        Args:
            seeds: One for each of `which`, in [0, 2**32).
            which: Indices of copies, shape (R,).

        Returns:
            The observations of all copies.
        """
        which = np.arange(self.num_envs) if which is None else which
        memory, source = self.copies.memory, self.source
        self.copies.forget(which)
        clear_range(which, memory)
        with seeded():  # whatever the seed, to put the generators back
            for number, seed in zip(which.tolist(), seeds, strict=True):
                source.look_at(self.data[number])
                source.place(seed)
                self._take_over(number)
        if not self.copies.control.acting.believed:
            set_first_matrices(which, self.copies.control, memory, self.model.qpos0)
        forward_range(which, memory)
        for number in which.tolist():
            self._look(number)
            self._measure(number)
        return self.observations()

    def step(self, actions: Array, steps: NDArray[np.int64] | None = None) -> BatchStep:
        """Execute action chunks, shape (N, H, A), in all copies.

        Args:
            actions: What lies outside the controllers' input range is clipped.
            steps: How many of the H steps each copy executes, shape (N,); all by
                default.

        Raises:
            RlcoError: If an action is NaN or infinite, or A is wrong.
            SimulationError: If a copy diverges, unless those are marked.
        """
        check_actions(actions)
        count, horizon, size = actions.shape
        if size != self.action_size:
            raise RlcoError(
                f"actions have {size} numbers; {self.name} takes {self.action_size}."
            )
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        actions = np.ascontiguousarray(actions, dtype=np.float64)
        reward = np.zeros((count, horizon))
        # robosuite's Python must look after each control step, or only at the end.
        stride = 1 if self._rewards or self.source.lags else horizon
        for first in range(0, horizon, stride):
            left = np.clip(steps - first, 0, stride)
            part = np.ascontiguousarray(actions[:, first : first + stride])
            self.copies.run(
                advance_range, self.copies.control, self.copies.memory, part, left
            )
            self._settle(left, steps - first <= stride, part, reward[:, first])
        if self._on_divergence == "raise" and self.diverged.any():
            raise SimulationError(self.name, np.flatnonzero(self.diverged).tolist())
        return BatchStep(
            self.observations(), reward, self.success, self.diverged.copy()
        )

    def observations(self) -> dict[str, Array]:
        """Return the present observations of all copies, each shape (N, K)."""
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
        """Change the copies `which` alone; see `rlco.physics.copies.Copies`.

        Resets keep the change, but for arrays that the task's own reset writes.

        Raises:
            RlcoError: If a name, a shape or a number is not allowed.
        """
        self.copies.randomise(
            which,
            fields,
            stiffness=stiffness,
            damping=damping,
            command_delay=command_delay,
        )

    def _take_over(self, number: int) -> None:
        """Keep what robosuite has just placed as the start of one copy's episode."""
        source, memory = self.source, self.copies.memory
        if source.reset_fields:
            values = {n: getattr(source.model, n)[None] for n in source.reset_fields}
            self.copies.patch_model(np.array([number]), values, derive=False)
        posture = self.data[number].qpos[self.copies.control.arm_qpos]
        memory.posture[number] = posture
        memory.grip[number] = 0.0
        self._caches[number] = {}

    def _settle(
        self,
        executed: NDArray[np.int64],
        last: NDArray[np.bool_],
        actions: Array,
        reward: Array,
    ) -> None:
        """Let robosuite's Python see the copies that have moved."""
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
