"""One task three times: by robosuite, and natively in both kinds of arithmetic."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.domain import SIM
from rlco.physics.global_random import seeded
from rlco.physics.native import NativeStepper
from rlco.physics.robosuite_batch import RobosuiteBatch
from rlco.physics.robosuite_stepper import keep_divergence
from rlco.physics.robosuite_tasks import make_plain
from rlco.physics.tabletop import Tabletop
from rlco.physics.task import TASK_NAMES, make_task

Array = NDArray[np.float64]
KINDS = {"exact": True, "fast": False}
#: By how much a step's reward differs, and whether its success flag does.
Differences = dict[str, tuple[float, bool]]


class RobosuitePair:
    """One of robosuite's tasks.

    Args:
        name: robosuite's name.
        copies: Native copies of each arithmetic; all are stepped, the first compared.
    """

    def __init__(self, name: str, copies: int = 1) -> None:
        self.env = make_plain(name, reward_shaping=True)
        keep_divergence(self.env)
        self.copies = copies
        self.native: dict[str, Any] = {
            kind: RobosuiteBatch(
                make_plain(name, reward_shaping=True),
                num_envs=copies,
                threads=1,
                exact=exact,
                observations=["object-state"],
            )
            for kind, exact in KINDS.items()
        }

    def start(self, seed: int) -> None:
        """Start the same episode everywhere."""
        with seeded(seed):
            self.env.reset()
        for native in self.native.values():
            native.reset([seed] * self.copies)

    def step(self, action: Array) -> Differences:
        """Execute a control step everywhere."""
        _, reward, _, _ = self.env.step(action)
        success = self.env._check_success()
        chunk = np.tile(action, (self.copies, 1, 1))
        found = {kind: native.step(chunk) for kind, native in self.native.items()}
        return {
            kind: (abs(reward - out.reward[0, 0]), bool(out.success[0] != success))
            for kind, out in found.items()
        }


class TaskPair:
    """One of rlco's tasks, in ``sim``, with the shaped reward; as `RobosuitePair`."""

    def __init__(self, name: str, copies: int = 1) -> None:
        self.task = make_task(name)
        self.env = Tabletop(self.task, SIM)
        keep_divergence(self.env)
        self.copies = copies
        self.native: dict[str, Any] = {
            kind: NativeStepper(self.task, SIM, num_envs=copies, threads=1, exact=exact)
            for kind, exact in KINDS.items()
        }

    def start(self, seed: int) -> None:
        """Start the same episode everywhere."""
        initial = self.task.sample(np.random.default_rng(seed), None)
        self.env.start(initial)
        for native in self.native.values():
            native.reset([initial] * self.copies)

    def step(self, action: Array) -> Differences:
        """Execute a control step everywhere."""
        before = self.env.scene_state()
        self.env.step(action)
        after = self.env.scene_state()
        reward = self.task.reward(before, after, "shaped")
        chunk = np.tile(action, (self.copies, 1, 1))
        found = {}
        for kind, native in self.native.items():
            state = native.step(chunk).at((0, 1))
            difference = abs(reward - self.task.reward(before, state, "shaped"))
            flag = self.task.success(after) != self.task.success(state)
            found[kind] = float(difference), bool(flag)
        return found


Pair = RobosuitePair | TaskPair


def make_pair(name: str, copies: int = 1) -> Pair:
    """Return the pair of a task: rlco's, or robosuite's."""
    return (TaskPair if name in TASK_NAMES else RobosuitePair)(name, copies)


def anchor(pair: Pair) -> None:
    """Copy robosuite's integration state into the native copies."""
    model, data = pair.env.sim.model._model, pair.env.sim.data._data
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    grip = pair.env.robots[0].gripper["right"].current_action
    for native in pair.native.values():
        mujoco.mj_setState(native.model, native.data[0], state, kind)
        native.copies.memory.grip[0] = grip


def apart(pair: Pair, kind: str, copy: int = 0) -> float:
    """Return the largest difference of a coordinate [rad, m]."""
    ours = pair.native[kind].data[copy].qpos
    return float(np.abs(pair.env.sim.data._data.qpos - ours).max())


def touching(env: Any) -> bool:
    """Return whether the robot ends a control step touching anything but itself."""
    model, data = env.sim.model._model, env.sim.data._data
    roots = model.body_rootid[model.geom_bodyid[data.contact.geom]]
    robot = model.body("robot0_base").rootid[0]
    return bool(((roots == robot).sum(axis=1) == 1).any())
