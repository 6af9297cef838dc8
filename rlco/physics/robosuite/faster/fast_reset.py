"""Reset of a robosuite environment without unnecessary work."""

from __future__ import annotations

from typing import Any

import numpy as np


def make_reset_cheap(env: Any) -> None:
    """Skip the parts of a reset that build names and clear what is not used here."""
    env._setup_references = _nothing
    env.sim.get_state = _nothing
    for observable in env._observables.values():
        observable.reset = _nothing


def _nothing() -> None:
    pass


class FastReset:
    """A robot whose reset places it without rebuilding controllers and buffers."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot
        self.action_dim = robot.action_dim

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    def reset(self, deterministic: bool = False) -> None:
        """Set the initial posture as robosuite's ``Robot.reset``, by the same draws."""
        del deterministic  # robosuite's signature; episodes are drawn
        robot = self._robot
        size, noise = len(robot.init_qpos), robot.initialization_noise
        if noise["type"] == "gaussian":
            shift = np.random.randn(size)  # noqa: NPY002
        else:
            shift = np.random.uniform(-1.0, 1.0, size)  # noqa: NPY002
        shift = shift * noise["magnitude"]
        qpos, arm = robot.sim.data.qpos, robot.arms[0]
        qpos[robot._ref_joint_pos_indexes] = robot.init_qpos + shift
        if robot.has_gripper[arm]:
            fingers = robot._ref_gripper_joint_pos_indexes[arm]
            qpos[fingers] = robot.gripper[arm].init_qpos
