"""How many control steps a second each backend makes, and how long a reset takes.

Run ``python benchmarks/stepping.py [rounds=30] [task=NAME]`` with OMP_NUM_THREADS=1; it
prints one markdown table a task: push_cube of rlco's own, then robosuite's Lift, Stack,
Door and NutAssembly. Every side steps from the same starts by the same random commands;
the sides take turns, so that what else the machine does meets all. A rate is the median
over rounds, a ratio the median of the rounds' ratios.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from rlco.physics.domain import SIM
from rlco.physics.global_random import seeded
from rlco.physics.native import NativeStepper
from rlco.physics.push_cube import TASK
from rlco.physics.robosuite_batch import RobosuiteBatch
from rlco.physics.robosuite_tasks import make_plain
from rlco.physics.tabletop import Tabletop

COPIES, STEPS, EPISODES = 16, 10, 4
TASKS = ("push_cube", "Lift", "Stack", "Door", "NutAssembly")
COMMANDS = np.random.default_rng(1).uniform(-0.5, 0.5, (COPIES, STEPS, 7))
Side = Callable[[], float]


def starts() -> list[Any]:
    """Return how the episodes of push_cube start."""
    return [TASK.sample(np.random.default_rng([0, i]), None) for i in range(COPIES)]


def native(task: str, *, threads: int, exact: bool = False) -> tuple[Any, Any]:
    """Return native copies, and a function that starts their episodes."""
    options: dict[str, Any] = {"num_envs": COPIES, "threads": threads, "exact": exact}
    if task == "push_cube":
        stepper = NativeStepper(TASK, SIM, **options)
        initial = starts()
        return stepper, lambda: stepper.reset(initial)
    env = make_plain(task, reward_shaping=True)
    batch = RobosuiteBatch(env, observations=["object-state"], **options)
    return batch, lambda: batch.reset(range(COPIES))


def rate(step: Callable[[], object], count: int) -> float:
    """Return how many of `count` things a second one call makes."""
    began = time.perf_counter()
    step()
    return count / (time.perf_counter() - began)


def native_side(task: str, **options: Any) -> Side:
    """Return a round of native stepping: its control steps a second."""
    copies, start = native(task, **options)

    def play() -> float:
        start()
        return rate(lambda: copies.step(COMMANDS), COPIES * STEPS)

    return play


def bare_side(task: str) -> Side:
    """Return a round of nothing but MuJoCo: the arm is held, nothing is computed."""
    copies, start = native(task, threads=1)
    control = copies.copies.control

    def run() -> None:
        for data in copies.data:
            mujoco.mj_step(copies.model, data, nstep=STEPS * control.substeps)

    def play() -> float:
        start()
        for data in copies.data:
            data.ctrl[control.arm_ctrl] = data.qfrc_bias[control.arm_dof]
        return rate(run, COPIES * STEPS)

    return play


def robosuite_episodes(task: str) -> tuple[Any, list[Callable[[], object]]]:
    """Return robosuite's own environment, and what starts each of its episodes."""
    if task == "push_cube":
        env = Tabletop(TASK, SIM)
        return env, [lambda s=s: env.start(s) for s in starts()]
    env = make_plain(task, reward_shaping=True)

    def start(seed: int) -> None:
        with seeded(seed):
            env.reset()

    return env, [lambda s=s: start(s) for s in range(COPIES)]


def robosuite_side(task: str) -> Side:
    """Return a round of robosuite's own step, in a few of the same episodes."""
    env, episodes = robosuite_episodes(task)

    def play() -> float:
        seconds = 0.0
        for start, commands in zip(episodes[:EPISODES], COMMANDS, strict=False):
            start()
            seconds += STEPS / rate(lambda c=commands: [env.step(a) for a in c], STEPS)
        return EPISODES * STEPS / seconds

    return play


def reset_sides(task: str) -> dict[str, Side]:
    """Return rounds of resets: placing objects and mj_forward, then whole ones."""
    copies, start = native(task, threads=1)
    env, episodes = robosuite_episodes(task)

    def place() -> None:
        for seed, data in enumerate(copies.data):
            if task == "push_cube":
                TASK.sample(np.random.default_rng([0, seed]), None)
            else:
                env.placement_initializer.sample()
            mujoco.mj_forward(copies.model, data)

    start()
    return {
        "placing objects and mj_forward": lambda: rate(place, COPIES),
        "native reset": lambda: rate(start, COPIES),
        "robosuite's reset": lambda: rate(
            lambda: [one() for one in episodes[:EPISODES]], EPISODES
        ),
    }


def table(title: str, unit: str, sides: dict[str, Side], rounds: int) -> None:
    """Measure all sides in turns, and print a table of ratios to the first."""
    for play in sides.values():
        play()  # compiled code is loaded, memory touched
    rates = np.array([[play() for play in sides.values()] for _ in range(rounds)])
    print(f"\n| {title} | {unit} a second | times the first [quartiles] |")
    print("|---|---|---|")
    for name, row, ratio in zip(sides, rates.T, (rates / rates[:, :1]).T, strict=True):
        low, middle, high = np.percentile(ratio, [25, 50, 75])
        middle_rate = np.median(row)
        print(f"| {name} | {middle_rate:.0f} | {middle:.2f} [{low:.2f}, {high:.2f}] |")


def main(rounds: int = 30, task: str = "") -> None:
    """Measure, and print the tables."""
    for name in [task] if task else TASKS:
        sides = {
            "robosuite": robosuite_side(name),
            "native, 1 thread": native_side(name, threads=1),
            "native, 1 thread, exact": native_side(name, threads=1, exact=True),
            "native, 2 threads": native_side(name, threads=2),
            "bare mj_step, 1 thread": bare_side(name),
        }
        table(name, "control steps", sides, rounds)
        table(f"{name}, resets", "resets", reset_sides(name), rounds)


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    main(int(given.get("rounds", 30)), given.get("task", ""))
