"""How closely native copies of robosuite's tasks follow robosuite.

Run ``python benchmarks/same_physics.py [episodes=50] [steps=200] [out=FOLDER]`` with
OMP_NUM_THREADS=1; it prints one markdown table. Every control step starts from
robosuite's state, random actions throughout, contacts included; differences are the
largest over all steps. ``open=1`` instead steps open loop, prints how far the joint
positions are apart after each second, and draws that into `out` if given.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from rlco.physics.global_random import seeded
from rlco.physics.robosuite_batch import RobosuiteBatch
from rlco.physics.robosuite_stepper import keep_divergence
from rlco.physics.robosuite_tasks import make_plain

TASKS = ("Lift", "Stack", "Door", "NutAssembly")


def make_pair(task: str, *, exact: bool) -> tuple[Any, RobosuiteBatch]:
    """Return robosuite's environment and one native copy of it."""
    env = make_plain(task, reward_shaping=True)
    keep_divergence(env)
    twin = make_plain(task, reward_shaping=True)
    return env, RobosuiteBatch(twin, num_envs=1, threads=1, exact=exact)


def start(env: Any, batch: RobosuiteBatch, seed: int) -> None:
    """Start the same episode on both."""
    with seeded(seed):
        env.reset()
    batch.reset([seed])


def anchor(env: Any, batch: RobosuiteBatch) -> None:
    """Copy robosuite's integration state into the native copy."""
    model, data = env.sim.model._model, env.sim.data._data
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    mujoco.mj_setState(batch.model, batch.data[0], state, kind)
    batch.copies.memory.grip[0] = env.robots[0].gripper["right"].current_action


def apart(env: Any, batch: RobosuiteBatch) -> float:
    """Return the largest difference of a coordinate [rad, m]."""
    return float(np.abs(env.sim.data._data.qpos - batch.data[0].qpos).max())


def anchored(task: str, exact: bool, episodes: int, steps: int) -> str:
    """Return a row of the table."""
    env, batch = make_pair(task, exact=exact)
    rows, flags = [], 0
    for seed in range(episodes):
        start(env, batch, seed)
        rng = np.random.default_rng(seed)
        for _ in range(steps):
            action = rng.uniform(-1, 1, batch.action_size)
            anchor(env, batch)
            _, reward, _, _ = env.step(action)
            out = batch.step(action[None, None])
            rows.append((apart(env, batch), abs(reward - out.reward[0, 0])))
            flags += bool(out.success[0] != env._check_success())
    qpos, reward = np.array(rows).T
    share = (qpos <= 1e-9).mean()
    return (
        f"| {task} | {'exact' if exact else 'fast'} | {qpos.size} | {share:.2%} | "
        f"{qpos.max():.0e} | {reward.max():.0e} | {flags} |"
    )


def open_loop(episodes: int, steps: int, out: str) -> None:
    """Print and draw how trajectories part."""
    curves = {}
    for task in TASKS:
        for exact in (True, False):
            env, batch = make_pair(task, exact=exact)
            found = np.zeros((episodes, steps))
            for seed in range(episodes):
                start(env, batch, seed)
                rng = np.random.default_rng(seed)
                for step in range(steps):
                    action = rng.uniform(-1, 1, batch.action_size)
                    env.step(action)
                    batch.step(action[None, None])
                    found[seed, step] = apart(env, batch)
            curves[f"{task}, {'exact' if exact else 'fast'}"] = found
            seconds = found[:, 19::20]
            print(task, exact, *(f"{x:.0e}" for x in np.median(seconds, axis=0)))
    if out:
        draw(curves, Path(out))


def draw(curves: dict[str, Any], folder: Path) -> None:
    """Write the figure: medians over episodes."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
    for name, found in curves.items():
        time = np.arange(1, found.shape[1] + 1) / 20
        axis.plot(time, np.maximum(np.median(found, axis=0), 1e-17), label=name)
    axis.set(xlabel="time [s]", ylabel="largest difference [rad, m]", yscale="log")
    axis.legend(fontsize="x-small", ncols=2)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "open_loop.png", dpi=150)


def main(episodes: int = 50, steps: int = 200) -> None:
    """Measure, and print the table."""
    columns = "task, arithmetic, control steps, within 1e-9, largest in qpos, "
    columns += "largest in reward, success flags that differ"
    print("| " + columns.replace(", ", " | ") + " |")
    print("|---|---|---|---|---|---|---|")
    for task in TASKS:
        for exact in (True, False):
            print(anchored(task, exact, episodes, steps), flush=True)


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    counts = int(given.get("episodes", 50)), int(given.get("steps", 200))
    if "open" in given:
        open_loop(*counts, given.get("out", ""))
    else:
        main(*counts)
