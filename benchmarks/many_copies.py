"""Memory and speed of the native backend as the number of worlds grows; leaks.

Run ``python benchmarks/many_copies.py [task=push_cube] [seconds=15] [out=FOLDER]`` with
OMP_NUM_THREADS=1: it prints a markdown table for N from 1 to 256, each N measured in a
process of its own for so many seconds, and writes a figure to `out` if given; about
three minutes. Speeds are medians over chunks, which short disturbances do not change.

``leak=STEPS [threads=1] [frequency=100]`` makes that many control steps instead, with
resets every 2.5 s of the episodes, and prints the resident memory every 100,000 steps:
what was printed stands when it is stopped. A higher control frequency [Hz] than the
task's own takes fewer physics steps for each control step, so that all of rlco's own
code runs as often in a fraction of the time.
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rlco.envs import make_env
from rlco.physics.tasks.make_task import make_task

NUMBERS = (1, 4, 16, 64, 128, 256)
CHUNK, HORIZON = 5, 50
LEAK_WORLDS, LEAK_ROW, LEAK_EPISODE = 64, 100_000, 2.5  # [s]


def resident() -> float:
    """Return this process's resident memory [MB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1e3


def measure(task: str, number: int, seconds: float) -> tuple[float, float]:
    """Return resident memory [MB] and control steps a second of N worlds."""
    env: Any = make_env(task, num_envs=number)
    stepper = env.backend if task.startswith("robosuite:") else env.stepper
    size = stepper.worlds.control.action_size
    rng = np.random.default_rng(0)
    took: list[float] = []
    until = np.inf  # until the first chunk is done, which loads what was compiled
    while time.perf_counter() < until or len(took) < 2:
        if len(took) % (HORIZON // CHUNK) == 0:
            env.reset()
        actions = rng.uniform(-0.5, 0.5, (number, CHUNK, size))
        began = time.perf_counter()
        stepper.step(actions)
        took.append(time.perf_counter() - began)
        if len(took) == 1:
            until = time.perf_counter() + seconds
    return resident(), number * CHUNK / float(np.median(took[1:]))


def grow(task: str, seconds: float, out: str) -> None:
    """Print the table, and draw it."""
    rows = []
    print(f"| worlds of {task} | resident memory [MB] | control steps a second |")
    print("|---|---|---|")
    for number in NUMBERS:
        options = f"task={task}", f"one={number}", f"seconds={seconds}"
        command = [sys.executable, __file__, *options]
        text = subprocess.run(command, capture_output=True, text=True, check=True)
        memory, speed = map(float, text.stdout.split()[-2:])
        rows.append((memory, speed))
        print(f"| {number} | {memory:.0f} | {speed:.0f} |", flush=True)
    if out:
        draw(task, np.array(rows), Path(out))


def draw(task: str, rows: np.ndarray, folder: Path) -> None:
    """Write the figure."""
    from rlco.reporting.plot_style import caption, new_figure, save_figure

    title = f"Memory and speed with many worlds of {task}"
    figure, panels = new_figure(title, 2, height=2.9)
    labels = "resident memory [MB]", "control steps a second"
    for axis, column, label in zip(panels, rows.T, labels, strict=True):
        axis.plot(NUMBERS, column, "o-", color="#0072b2", markersize=4)
        axis.set(xlabel="worlds", ylabel=label, xscale="log")
        axis.set_xticks(NUMBERS, [str(number) for number in NUMBERS])
        axis.minorticks_off()
        axis.set_ylim(0, 1.1 * column.max())
    caption(figure, "One process a point; native, one thread a core.")
    save_figure(figure, folder / "many_copies.png")


def leak(name: str, steps: int, threads: int | None, frequency: int | None) -> None:
    """Make control steps with resets, and print the resident memory on the way."""
    task = make_task(name)
    if frequency is not None:
        task = replace(task, control_frequency=frequency)
    horizon = round(LEAK_EPISODE * task.control_frequency)
    env = make_env(
        task, num_envs=LEAK_WORLDS, chunk=CHUNK, horizon=horizon, threads=threads
    )
    td = env.reset()
    done = printed = 0
    print("| control steps | resident memory [MB] | divergences |")
    print("|---|---|---|", flush=True)
    while done < steps:
        td.set("action", env.action_spec.rand())
        _, td = env.step_and_maybe_reset(td)
        done += LEAK_WORLDS * CHUNK
        if done - printed >= LEAK_ROW or done >= steps:
            printed = done
            print(f"| {done} | {resident():.1f} | {env.divergences} |", flush=True)


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    name = given.get("task", "push_cube")
    length = float(given.get("seconds", 15))
    if "one" in given:
        print(*measure(name, int(given["one"]), length))
    elif "leak" in given:
        count, rate = (
            int(given[key]) if key in given else None
            for key in ("threads", "frequency")
        )
        leak(name, int(given["leak"]), count, rate)
    else:
        grow(name, length, given.get("out", ""))
