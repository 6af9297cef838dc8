"""What the stepping tests share: starts of push_cube, and an eye on robot contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlco.physics.spec.task import InitialState
from rlco.physics.tasks.push_cube import TASK

Array = NDArray[np.float64]


def starts(count: int, seed: int = 0) -> list[InitialState]:
    """Draw starts of push_cube, each from a stream of its own."""
    return [TASK.sample(np.random.default_rng([seed, i]), None) for i in range(count)]


class Watch:
    """Notes what the robot of a robosuite environment touches in any physics step.

    Attributes:
        touched: Whether it touched anything, one finger the other included, since
            this was last set to False.
        touched_others: The same of anything but itself.
    """

    def __init__(self, env: Any) -> None:
        self.touched = self.touched_others = False
        self._env, self._before = env, env._pre_action
        # robosuite calls this between MuJoCo's collision and its solver.
        env._pre_action = self._pre_action

    def _pre_action(self, action: Array, policy_step: bool = False) -> None:
        self._before(action, policy_step)
        sim = self._env.sim
        model, data = sim.model._model, sim.data._data
        roots = model.body_rootid[model.geom_bodyid[data.contact.geom]]
        robot = model.body("robot0_base").rootid[0]
        of_robot = (roots == robot).sum(axis=1)
        self.touched |= bool((of_robot > 0).any())
        self.touched_others |= bool((of_robot == 1).any())

    def clear(self) -> None:
        """Forget what was touched."""
        self.touched = self.touched_others = False
