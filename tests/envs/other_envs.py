"""Environments that are not rlco's own, for the tests of its transforms."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from torchrl.envs import LiberoWrapper


class Counter(gymnasium.Env[Any, Any]):
    """Counts its steps; the reward is the action, success the third step.

    Observations are float64, the action lies in [-2, 4], and ``info`` holds plain
    Python values, as Gymnasium's environments mostly do.
    """

    def __init__(self, horizon: int = 5, *, tells: bool = True) -> None:
        self.observation_space: Any = gymnasium.spaces.Box(-9, 9, (2,), np.float64)
        self.action_space = gymnasium.spaces.Box(-2.0, 4.0, (1,), np.float32)
        self.horizon, self.tells, self.count = horizon, tells, 0

    def _seen(self) -> NDArray[np.float64]:
        return np.array([self.count, self.horizon], dtype=np.float64)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        """Start at zero; the info of a reset says nothing."""
        super().reset(seed=seed)
        self.count = 0
        return self._seen(), {}

    def step(self, action: Any) -> Any:
        """Count."""
        self.count += 1
        info = {"success": self.count == 3} if self.tells else {}
        ended = self.count >= self.horizon
        return self._seen(), float(action[0]), False, ended, info


class LiberoLift:
    """robosuite's Lift with the few methods that TorchRL asks of a LIBERO task."""

    language_instruction = "lift the cube"

    def __init__(self, size: int = 32) -> None:
        import robosuite

        self.env = robosuite.make(
            "Lift",
            robots="Panda",
            has_renderer=False,
            has_offscreen_renderer=True,
            use_camera_obs=True,
            camera_heights=size,
            camera_widths=size,
            horizon=50,
        )

    def seed(self, seed: int) -> None:
        """Seed the placement of the cube."""
        self.env.rng = np.random.default_rng(seed)

    def reset(self) -> Any:
        """Start an episode."""
        return self.env.reset()

    def step(self, action: NDArray[np.float64]) -> Any:
        """Execute a control step."""
        return self.env.step(action)

    def check_success(self) -> bool:
        """Whether the cube is lifted."""
        return bool(self.env._check_success())


def libero_lift(horizon: int = 8) -> LiberoWrapper:
    """Return TorchRL's wrapper for LIBERO around robosuite's Lift."""
    return LiberoWrapper(LiberoLift(), max_episode_steps=horizon, settle_steps=2)
