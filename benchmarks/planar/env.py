"""The planar task as a TorchRL environment."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from planar.gaps import NUMBERS, Gap
from planar.world import World, draw_start
from rlco.data.instructions import InstructionText
from rlco.envs.chunk_env import ChunkEnv

Array = NDArray[np.float64]

CHUNK = 4  # control steps of a decision
TRAINING_HORIZON = 64  # control steps of a training episode
STAYING = 0.05  # reward of a control step that ends in a solved state


class PlanarTask:
    """What environments and policies ask of a task."""

    name: ClassVar[str] = "planar_push"
    instructions: ClassVar[tuple[str, ...]] = (
        "push the first disc onto its mark",
        "push the second disc onto its mark",
        "push the third disc onto its mark",
    )
    horizon: ClassVar[int] = 120
    control_frequency: ClassVar[int] = 20
    action_limit: ClassVar[float | None] = 1.0
    state_names: ClassVar[tuple[str, ...]] = ("tool.x", "tool.y")
    environment_state_names: ClassVar[tuple[str, ...]] = tuple(
        f"{what}{index}.{axis}"
        for what in ("disc", "mark")
        for index in range(3)
        for axis in "xy"
    )
    action_names: ClassVar[tuple[str, ...]] = ("tool.vx", "tool.vy")

    def description(self) -> dict[str, Any]:
        """Return what a policy's user must know of it, in types of JSON."""
        return {
            "task": self.name,
            "instructions": list(self.instructions),
            "control_frequency": self.control_frequency,
            "state_names": list(self.state_names),
            "environment_state_names": list(self.environment_state_names),
            "action_names": list(self.action_names),
        }


class PlanarEnv(ChunkEnv):
    """N episodes of the planar task in one domain; see `ChunkEnv`.

    The reward of a control step is the growth of `World.potential`, and
    `STAYING` where it ends in a solved state.

    Args:
        gap: How the domain moves and observes.
        num_envs: N.
        seed: Draws starts and sensor noise.
        horizon: Control steps of an episode; the task's own where absent.
    """

    def __init__(
        self, gap: Gap, *, num_envs: int, seed: int, horizon: int | None = None
    ) -> None:
        super().__init__(
            PlanarTask(),
            num_envs=num_envs,
            chunk=CHUNK,
            action_size=len(PlanarTask.action_names),
            horizon=horizon,
            seed=seed,
            on_divergence="raise",
        )
        self.world = World(num_envs, gap)
        # One row of sensor noise for the start and for each decision of an episode.
        decisions = -(-self.horizon // CHUNK)
        self._noise = np.zeros((num_envs, decisions + 1, NUMBERS // 2, 2))
        self._observe_as(len(PlanarTask.state_names), NUMBERS, None)

    def _start(self, which: NDArray[np.int64], episodes: list[int]) -> None:
        starts = []
        for env, index in zip(which.tolist(), episodes, strict=True):
            starts.append(draw_start(np.random.default_rng([self._seed, index])))
            # Its own stream, so that noise never shifts the starts.
            rng = np.random.default_rng([self._seed, index, 1])
            self._noise[env] = rng.standard_normal(self._noise.shape[1:])
        self.world.reset(which.tolist(), starts)
        self._instruction_id[:] = self.world.target

    def _advance(
        self, actions: Array, steps: NDArray[np.int64]
    ) -> tuple[Array, NDArray[np.bool_]]:
        reward = np.zeros(len(steps))
        before = self.world.potential()
        for step in range(self.chunk):
            active = step < steps
            self.world.step(actions[:, step], active)
            after = self.world.potential()
            reward += active * (after - before + STAYING * self.world.solved())
            before = after
        return reward, np.zeros(len(steps), dtype=np.bool_)

    def _seen(self) -> dict[str, torch.Tensor]:
        row = -(-self._elapsed // self.chunk)
        noise = self._noise[np.arange(row.size), row]
        state, environment_state = self.world.observed(noise)
        return {
            "state": torch.from_numpy(state).float(),
            "environment_state": torch.from_numpy(environment_state).float(),
        }

    def _texts(self) -> InstructionText:
        # A stack of strings would take as long as all of the physics.
        ids = torch.from_numpy(self._instruction_id.copy())
        return InstructionText(
            ids=ids, table=self.task.instructions, batch_size=self.batch_size
        )

    def _solved(self) -> NDArray[np.bool_]:
        return self.world.solved()
