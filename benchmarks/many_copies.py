"""Memory and speed of the native backend as the number of copies grows; leaks.

Run ``python benchmarks/many_copies.py [task=push_cube] [out=FOLDER]`` with
OMP_NUM_THREADS=1: it prints a markdown table for N from 1 to 256, each N measured in a
process of its own, and writes a figure to `out` if given. ``leak=STEPS`` makes that
many control steps instead, with resets, and prints the resident memory on the way.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from rlco.envs import make_env

NUMBERS = (1, 4, 16, 64, 128, 256)
CHUNK, HORIZON = 5, 50


def resident() -> float:
    """Return this process's resident memory [MB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1e3


def measure(task: str, number: int) -> tuple[float, float]:
    """Return resident memory [MB] and control steps a second of N copies."""
    env = make_env(task, num_envs=number)
    copies: Any = getattr(env, "stepper", None) or getattr(env, "backend")  # noqa: B009
    env.reset()
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.5, 0.5, (number, CHUNK, copies.copies.control.action_size))
    copies.step(actions)
    repeats = max(1, 64 // number)
    began = time.perf_counter()
    for _ in range(repeats):
        copies.step(actions)
    return resident(), repeats * number * CHUNK / (time.perf_counter() - began)


def grow(task: str, out: str) -> None:
    """Print the table, and draw it."""
    rows = []
    print(f"| copies of {task} | resident memory [MB] | control steps a second |")
    print("|---|---|---|")
    for number in NUMBERS:
        command = [sys.executable, __file__, f"task={task}", f"one={number}"]
        text = subprocess.run(command, capture_output=True, text=True, check=True)
        memory, speed = map(float, text.stdout.split()[-2:])
        rows.append((memory, speed))
        print(f"| {number} | {memory:.0f} | {speed:.0f} |", flush=True)
    if out:
        draw(task, np.array(rows), Path(out))


def draw(task: str, rows: np.ndarray, folder: Path) -> None:
    """Write the figure."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(7, 2.6), layout="constrained")
    for axis, column, label in zip(
        axes, rows.T, ("resident memory [MB]", "control steps a second"), strict=True
    ):
        axis.plot(NUMBERS, column, "o-")
        axis.set(xlabel=f"copies of {task}", ylabel=label, xscale="log", ylim=0)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "many_copies.png", dpi=150)


def leak(task: str, steps: int) -> None:
    """Make control steps with resets, and print the resident memory ten times."""
    number = 16
    env = make_env(task, num_envs=number, chunk=CHUNK, horizon=HORIZON)
    td = env.reset()
    per_decision, done, marks = number * CHUNK, 0, 0
    print("| control steps | resident memory [MB] | divergences |")
    print("|---|---|---|")
    while done < steps:
        td.set("action", env.action_spec.rand())
        _, td = env.step_and_maybe_reset(td)
        done += per_decision
        if done >= (marks + 1) * steps / 10:
            marks += 1
            print(f"| {done} | {resident():.1f} | {env.divergences} |", flush=True)


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    name = given.get("task", "push_cube")
    if "one" in given:
        print(*measure(name, int(given["one"])))
    elif "leak" in given:
        leak(name, int(given["leak"]))
    else:
        grow(name, given.get("out", ""))
