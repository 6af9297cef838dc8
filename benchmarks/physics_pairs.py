"""One task three times: by robosuite, and natively in both kinds of arithmetic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.native.robosuite_batch import RobosuiteBatch
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.global_random import seeded
from rlco.physics.robosuite.stepper import keep_divergence
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.robosuite.tasks import make_plain
from rlco.physics.spec.domain import SIM, Domain
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.tasks.make_task import make_task

Array = NDArray[np.float64]
KINDS = {"exact": True, "fast": False}


@dataclass(frozen=True)
class Difference:
    """In what a native control step differs from robosuite's.

    Attributes:
        reward: The shaped reward.
        flag: Whether the success flags differ.
        seen: The largest difference of what the task's rules and observations read:
            robosuite's `object-state`, or all of rlco's `SceneState`.
    """

    reward: float
    flag: bool
    seen: float


Differences = dict[str, Difference]


class RobosuitePair:
    """One of robosuite's tasks, with the shaped reward.

    Args:
        name: robosuite's name.
        copies: Native copies of each arithmetic; all are stepped, the first compared.
    """

    def __init__(self, name: str, copies: int = 1) -> None:
        self.env = make_plain(name, reward_shaping=True)
        keep_divergence(self.env)
        self.worlds = copies
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
            native.reset([seed] * self.worlds)

    def step(self, action: Array) -> Differences:
        """Execute a control step everywhere."""
        seen, reward, _, _ = self.env.step(action)
        success = self.env._check_success()
        chunk = np.tile(action, (self.worlds, 1, 1))
        found = {kind: native.step(chunk) for kind, native in self.native.items()}
        return {
            kind: Difference(
                float(abs(reward - out.reward[0, 0])),
                bool(out.success[0] != success),
                largest(seen["object-state"], out.observations["object-state"][0]),
            )
            for kind, out in found.items()
        }


class TaskPair:
    """One of rlco's tasks in a domain, with the shaped reward; as `RobosuitePair`.

    Args:
        name: The task's name.
        copies: Native copies of each arithmetic; all are stepped, the first compared.
        domain: The domain.
        variation: A named variation of the scene.
    """

    def __init__(
        self,
        name: str,
        copies: int = 1,
        domain: Domain = SIM,
        variation: str | None = None,
    ) -> None:
        self.task = make_task(name)
        self.variation = variation
        self.env = Tabletop(self.task, domain, variation=variation)
        keep_divergence(self.env)
        self.worlds = copies
        self.native: dict[str, Any] = {
            kind: NativeStepper(
                self.task,
                domain,
                num_envs=copies,
                threads=1,
                exact=exact,
                variation=variation,
            )
            for kind, exact in KINDS.items()
        }

    def start(self, seed: int) -> None:
        """Start the same episode everywhere."""
        initial = self.task.sample(np.random.default_rng(seed), self.variation)
        self.env.start(initial)
        for native in self.native.values():
            native.reset([initial] * self.worlds)

    def step(self, action: Array) -> Differences:
        """Execute a control step everywhere."""
        before = self.env.scene_state()
        self.env.step(action)
        after = self.env.scene_state()
        reward = self.task.reward(before, after, "shaped")
        chunk = np.tile(action, (self.worlds, 1, 1))
        found = {}
        for kind, native in self.native.items():
            state = native.step(chunk).at((0, 1))
            found[kind] = Difference(
                float(abs(reward - self.task.reward(before, state, "shaped"))),
                bool(self.task.success(after) != self.task.success(state)),
                max(largest(v, vars(state)[k]) for k, v in vars(after).items()),
            )
        return found


Pair = RobosuitePair | TaskPair


def make_pair(name: str, copies: int = 1, domain: Domain = SIM) -> Pair:
    """Return the pair of a task: rlco's in the domain, or robosuite's."""
    if name in TASK_NAMES:
        return TaskPair(name, copies, domain)
    return RobosuitePair(name, copies)


def random_action(pair: Pair, rng: np.random.Generator) -> Array:
    """Draw any action."""
    size = pair.native["fast"].worlds.control.action_size
    return rng.uniform(-1.0, 1.0, size)


def contact_action(pair: Pair, rng: np.random.Generator) -> Array:
    """Draw an action that seeks contact.

    The scripted expert's with noise; for robosuite's tasks, which have no expert, a
    random one that goes down.
    """
    if isinstance(pair, TaskPair):
        action = pair.task.expert(pair.env.scene_state())
        action[:6] += 0.2 * rng.standard_normal(6)
    else:
        action = random_action(pair, rng)
        action[2] -= 0.6
    return np.clip(action, -1.0, 1.0)


def largest(one: Array, other: Array) -> float:
    """Return the largest difference of two arrays' numbers, 0 of empty ones."""
    return float(np.abs(one - other).max(initial=0.0))


def anchor(pair: Pair) -> None:
    """Copy robosuite's integration state into the native copies."""
    model, data = pair.env.sim.model._model, pair.env.sim.data._data
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    grip = pair.env.robots[0].gripper["right"].current_action
    for native in pair.native.values():
        mujoco.mj_setState(native.model, native.data[0], state, kind)
        native.worlds.memory.grip[0] = grip


def apart(pair: Pair, kind: str, copy: int = 0) -> float:
    """Return the largest difference of a coordinate [rad, m]."""
    return largest(pair.env.sim.data._data.qpos, pair.native[kind].data[copy].qpos)


def touching(env: Any) -> bool:
    """Return whether the robot ends a control step touching anything but itself."""
    model, data = env.sim.model._model, env.sim.data._data
    roots = model.body_rootid[model.geom_bodyid[data.contact.geom]]
    robot = model.body("robot0_base").rootid[0]
    return bool(((roots == robot).sum(axis=1) == 1).any())
