"""How many control steps a second each backend makes, and how long a reset takes.

Run ``python benchmarks/stepping.py [rounds=30] [tasks=push_cube,Lift]`` with
OMP_NUM_THREADS=1; it prints two markdown tables a task, of rlco's four, then of
robosuite's Lift, Stack, Door and NutAssembly. Every side steps from the same starts by
the same random commands; the sides take turns, so that what else the machine does meets
all. A rate is the median over rounds, a ratio the median of the rounds' ratios.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from rlco.physics.native.robosuite_batch import RobosuiteBatch
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.global_random import seeded
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.robosuite.tasks import make_plain
from rlco.physics.spec.domain import SIM
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.tasks.make_task import make_task

COPIES, STEPS, EPISODES = 16, 10, 4
TASKS = (*TASK_NAMES, "Lift", "Stack", "Door", "NutAssembly")
BARE = "bare mj_step, 1 thread"
COMMANDS = np.random.default_rng(1).uniform(-0.5, 0.5, (COPIES, STEPS, 7))
Side = Callable[[], float]


def starts(task: str) -> list[Any]:
    """Return how the episodes of one of rlco's tasks start."""
    sample = make_task(task).sample
    return [sample(np.random.default_rng([0, i]), None) for i in range(COPIES)]


def native(task: str, *, threads: int, exact: bool = False) -> tuple[Any, Any]:
    """Return native copies, and a function that starts their episodes."""
    options: dict[str, Any] = {"num_envs": COPIES, "threads": threads, "exact": exact}
    if task in TASK_NAMES:
        stepper = NativeStepper(make_task(task), SIM, **options)
        initial = starts(task)
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
    control = copies.worlds.control

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
    if task in TASK_NAMES:
        env = Tabletop(make_task(task), SIM)
        return env, [lambda s=s: env.start(s) for s in starts(task)]
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
            if task in TASK_NAMES:
                make_task(task).sample(np.random.default_rng([0, seed]), None)
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
    """Measure all sides in turns, and print ratios to the first, and to `BARE`."""
    for play in sides.values():
        play()  # compiled code is loaded, memory touched
    rates = np.array([[play() for play in sides.values()] for _ in range(rounds)])
    bare = list(sides).index(BARE) if BARE in sides else None
    more = "" if bare is None else f" of {BARE} |"
    print(f"\n| {title} | {unit} a second | times the first [quartiles] |{more}")
    print("|---|---|---|" + ("" if bare is None else "---|"))
    for name, row in zip(sides, rates.T, strict=True):
        low, middle, high = np.percentile(row / rates[:, 0], [25, 50, 75])
        text = (
            f"| {name} | {np.median(row):.0f} | {middle:.2f} [{low:.2f}, {high:.2f}] |"
        )
        if bare is not None:
            text += f" {np.median(row / rates[:, bare]):.0%} |"
        print(text, flush=True)


def stepping_sides(task: str) -> dict[str, Side]:
    """Return rounds of control steps: robosuite's, native ones, nothing but MuJoCo."""
    return {
        "robosuite": robosuite_side(task),
        "native, 1 thread": native_side(task, threads=1),
        "native, 1 thread, exact": native_side(task, threads=1, exact=True),
        "native, 2 threads": native_side(task, threads=2),
        "native, 2 threads, exact": native_side(task, threads=2, exact=True),
        BARE: bare_side(task),
    }


def main(rounds: int = 30, tasks: tuple[str, ...] = TASKS) -> None:
    """Measure, and print the tables."""
    for name in tasks:
        table(name, "control steps", stepping_sides(name), rounds)
        table(f"{name}, resets", "resets", reset_sides(name), rounds)


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    chosen = tuple(given["tasks"].split(",")) if "tasks" in given else TASKS
    main(int(given.get("rounds", 30)), chosen)
