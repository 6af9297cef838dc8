"""How many control steps a second each backend makes, in one run, in turns.

Run ``python benchmarks/stepping.py [rounds]`` with OMP_NUM_THREADS=1; it prints one
markdown table. Every side steps push_cube in ``sim`` from the same starts by the same
random commands; the sides take turns, so that what else the machine does meets all.
A rate is the median over rounds, a ratio the median of the rounds' ratios.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import mujoco
import numpy as np

from rlco.physics.domain import SIM
from rlco.physics.native import NativeStepper
from rlco.physics.push_cube import TASK
from rlco.physics.tabletop import Tabletop

COPIES, STEPS, SUBSTEPS = 16, 10, 25
STARTS = [TASK.sample(np.random.default_rng([0, i]), None) for i in range(COPIES)]
COMMANDS = np.random.default_rng(1).uniform(-0.5, 0.5, (COPIES, STEPS, 7))


def native_side(*, exact: bool, threads: int) -> Callable[[], float]:
    """Return a round of the native stepper: its control steps a second."""
    stepper = NativeStepper(TASK, SIM, num_envs=COPIES, threads=threads, exact=exact)

    def play() -> float:
        stepper.reset(STARTS)
        began = time.perf_counter()
        stepper.step(COMMANDS)
        return COPIES * STEPS / (time.perf_counter() - began)

    return play


def robosuite_side() -> Callable[[], float]:
    """Return a round of robosuite's own step, in a few of the same episodes."""
    env = Tabletop(TASK, SIM)
    episodes = 4

    def play() -> float:
        seconds = 0.0
        for start, commands in zip(STARTS[:episodes], COMMANDS[:episodes], strict=True):
            env.start(start)
            began = time.perf_counter()
            for command in commands:
                env.step(command)
            seconds += time.perf_counter() - began
        return episodes * STEPS / seconds

    return play


def bare_side() -> Callable[[], float]:
    """Return a round of nothing but MuJoCo: the arm is held, nothing is computed."""
    stepper = NativeStepper(TASK, SIM, num_envs=COPIES, threads=1)

    lay = stepper.layout
    first = int(lay.integers[2])  # the arm's first actuator

    def play() -> float:
        stepper.reset(STARTS)
        for data in stepper.data:
            data.ctrl[first : first + 7] = data.qfrc_bias[lay.arm_dof]
        began = time.perf_counter()
        for data in stepper.data:
            mujoco.mj_step(stepper.model, data, nstep=STEPS * SUBSTEPS)
        return COPIES * STEPS / (time.perf_counter() - began)

    return play


def main(rounds: int) -> None:
    """Measure, and print the table."""
    sides = {
        "robosuite": robosuite_side(),
        "native, 1 thread": native_side(exact=False, threads=1),
        "native, 1 thread, exact": native_side(exact=True, threads=1),
        "native, 2 threads": native_side(exact=False, threads=2),
        "bare mj_step / 25, 1 thread": bare_side(),
    }
    for play in sides.values():
        play()  # compiled code is loaded, memory touched
    rates = np.array([[play() for play in sides.values()] for _ in range(rounds)])
    ratios = rates / rates[:, :1]
    print("| side | control steps a second | times robosuite [quartiles] |")
    print("|---|---|---|")
    for name, rate, ratio in zip(sides, rates.T, ratios.T, strict=True):
        low, middle, high = np.percentile(ratio, [25, 50, 75])
        print(
            f"| {name} | {np.median(rate):.0f} | {middle:.2f} [{low:.2f}, {high:.2f}] |"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 30)
