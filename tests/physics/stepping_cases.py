"""What the stepping tests share: a robosuite environment that notes robot contacts."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.domain import Domain
from rlco.physics.native import NativeStepper
from rlco.physics.push_cube import TASK
from rlco.physics.tabletop import Tabletop
from rlco.physics.task import InitialState, Task

Array = NDArray[np.float64]


class WatchedTabletop(Tabletop):
    """Notes what the robot touched in any physics step of the last control step.

    Attributes:
        touched: Whether it touched anything, one finger the other included.
        touched_others: Whether it touched anything but itself.
    """

    touched = touched_others = False

    def step(self, action: Array) -> Any:
        self.touched = self.touched_others = False
        return super().step(action)

    def _pre_action(self, action: Array, policy_step: bool = False) -> None:
        # robosuite calls this between MuJoCo's collision and its solver.
        super()._pre_action(action, policy_step)
        model, data = self.sim.model._model, self.sim.data._data
        bodies = model.geom_bodyid[data.contact.geom]
        roots = model.body_rootid[bodies]
        robot = model.body("robot0_base").rootid[0]
        self.touched |= bool((roots == robot).any())
        self.touched_others |= bool(((roots == robot).sum(axis=1) == 1).any())


def starts(count: int, seed: int = 0) -> list[InitialState]:
    """Draw starts of push_cube, each from a stream of its own."""
    return [TASK.sample(np.random.default_rng([seed, i]), None) for i in range(count)]


def anchor(env: Tabletop, stepper: NativeStepper) -> None:
    """Copy robosuite's integration state into the native stepper's first copy."""
    model, data = env.sim.model._model, env.sim.data._data
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_setState(stepper.model, stepper.data[0], state, kind)
    stepper.copies.memory.grip[0] = env.robots[0].gripper["right"].current_action


def deviation(env: Tabletop, stepper: NativeStepper) -> float:
    """Return the largest difference of any coordinate [rad, m]."""
    return float(np.abs(env.sim.data._data.qpos - stepper.data[0].qpos).max())


def make_pair(
    domain: Domain, *, exact: bool, task: Task = TASK, variation: str | None = None
) -> tuple[WatchedTabletop, NativeStepper]:
    """Build the same task on both backends."""
    stepper = NativeStepper(
        task, domain, num_envs=1, threads=1, exact=exact, variation=variation
    )
    return WatchedTabletop(task, domain, variation=variation), stepper
