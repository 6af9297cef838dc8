"""Pairs of a plain robosuite environment and its native copies, compared."""

from __future__ import annotations

import functools
import random
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from rlco.physics.native.robosuite_batch import RobosuiteBatch
from rlco.physics.robosuite.robosuite_api import load_composite_controller_config
from rlco.physics.robosuite.stepper import keep_divergence
from rlco.physics.robosuite.tasks import make_plain

JOINTS = {
    "type": "JOINT_POSITION",
    "input_max": 1,
    "input_min": -1,
    "output_max": 0.05,
    "output_min": -0.05,
    "kp": 50,
    "damping_ratio": 1,
    "impedance_mode": "fixed",
    "qpos_limits": None,
    "interpolation": None,
}
WORLD = {"input_ref_frame": "world"}
# name: robosuite's environment, its robot, what differs in the arm's controller
CASES: dict[str, tuple[str, str, dict[str, Any]]] = {
    "Lift": ("Lift", "Panda", {}),
    "Stack": ("Stack", "Panda", {}),
    "Door": ("Door", "Panda", {}),
    "NutAssembly": ("NutAssembly", "Panda", {}),
    "NutAssemblySquare": ("NutAssemblySquare", "Panda", {}),
    "joint position": ("Lift", "Panda", JOINTS),
    "world frame": ("Lift", "Panda", WORLD),
    "six joints": ("Lift", "UR5e", {}),
    "three fingers": ("Lift", "Jaco", {}),
}


def arm_config(robot: str, changes: dict[str, Any]) -> dict[str, Any]:
    """Return robosuite's configuration of a robot's arm with changes."""
    config = load_composite_controller_config(controller="BASIC", robot=robot)
    arm = {**config["body_parts"]["right"], **changes}
    if arm["type"] == "JOINT_POSITION":
        arm.pop("position_limits", None)
    return {**config, "body_parts": {"right": arm}}


def make_case(name: str, **options: Any) -> Any:
    """Build the robosuite environment of a case, with the shaped reward."""
    env, robot, changes = CASES[name]
    options = {"robots": robot, "reward_shaping": True, **options}
    return make_plain(env, controller_configs=arm_config(robot, changes), **options)


@functools.cache
def pair(name: str, *, exact: bool) -> tuple[Any, RobosuiteBatch]:
    """Return a case's plain environment and one native copy of it."""
    env = make_case(name)
    keep_divergence(env)
    batch = RobosuiteBatch(make_case(name), num_envs=1, threads=1, exact=exact)
    return env, batch


def start(env: Any, batch: RobosuiteBatch, seed: int) -> dict[str, Any]:
    """Start the same episode on both; return robosuite's observations."""
    np.random.seed(seed)  # noqa: NPY002
    random.seed(seed)
    seen: dict[str, Any] = env.reset()
    batch.reset([seed])
    return seen


def anchor(env: Any, batch: RobosuiteBatch) -> None:
    """Copy robosuite's integration state into the native copy."""
    model, data = env.sim.model._model, env.sim.data._data
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_setState(batch.model, batch.data[0], state, kind)
    batch.worlds.memory.grip[0] = env.robots[0].gripper["right"].current_action


@dataclass
class Worst:
    """The largest differences found: coordinates, observations, rewards."""

    qpos: float = 0.0
    observation: float = 0.0
    reward: float = 0.0


def compare_observations(seen: dict[str, Any], ours: dict[str, Any]) -> float:
    """Return the largest difference; the names must be robosuite's."""
    assert seen.keys() == ours.keys()
    return max(float(np.abs(np.ravel(seen[k]) - ours[k][0]).max()) for k in ours)


def compare(name: str, *, exact: bool, episodes: int, steps: int) -> Worst:
    """Compare resets, then control steps that each start from robosuite's state."""
    env, batch = pair(name, exact=exact)
    worst = Worst()
    for episode in range(episodes):
        seen = start(env, batch, seed=episode)
        assert (env.sim.data._data.qpos == batch.data[0].qpos).all()
        assert compare_observations(seen, batch.observations()) == 0.0
        rng = np.random.default_rng(episode)
        for _ in range(steps):
            action = rng.uniform(-1.0, 1.0, batch.action_size)
            anchor(env, batch)
            seen, reward, _, _ = env.step(action)
            out = batch.step(action[None, None])
            apart = np.abs(env.sim.data._data.qpos - batch.data[0].qpos).max()
            worst.qpos = max(worst.qpos, float(apart))
            worst.observation = max(
                worst.observation, compare_observations(seen, out.observations)
            )
            worst.reward = max(worst.reward, abs(reward - out.reward[0, 0]))
            assert out.success[0] == env._check_success()
    return worst
