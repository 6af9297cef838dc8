"""How closely native copies of tasks follow robosuite.

Run ``python benchmarks/same_physics.py [tasks=Lift,Door] [episodes=50] [steps=200]``
with OMP_NUM_THREADS=1; it prints one markdown table, a task's rows as they come. Every
control step starts from robosuite's state, random actions throughout, contacts
included; differences are the largest over all steps. ``domain=stand_in`` plays rlco's
tasks there; robosuite's have no domains. ``actions=contact`` plays the scripted
expert's actions with noise, and random ones that go down in robosuite's tasks.

``open=1 out=FOLDER`` instead steps open loop and draws how far the coordinates get
apart into ``FOLDER/open_loop.png``. What to compare it with: the same episodes in
robosuite's own arithmetic, started with the arm's first joint 1e-15 rad aside.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from physics_pairs import (
    KINDS,
    Pair,
    anchor,
    apart,
    contact_action,
    make_pair,
    random_action,
    touching,
)

from rlco.physics.spec.domain import SIM, Domain, make_domain
from rlco.physics.spec.names import TASK_NAMES

TASKS = ("Lift", "Stack", "Door", "NutAssembly", *TASK_NAMES)
NUDGE = 1e-15  # [rad]
MARKS = (1, 2, 5, 10)  # [s]
RATE = 20  # control steps a second
LOOKS = (("#56b4e9", 3.2), ("#e69f00", 2.2), ("#009e73", 1.6), ("#0b3c6f", 1.0))
ACTIONS = {"random": random_action, "contact": contact_action}
Act = Callable[[Pair, np.random.Generator], NDArray[np.float64]]
Curves = dict[str, NDArray[np.float64]]


def anchored(pair: Pair, name: str, act: Act, episodes: int, steps: int) -> list[str]:
    """Return a task's rows of the table."""
    contacts = 0
    found: dict[str, list[tuple[float, float, bool]]] = {k: [] for k in KINDS}
    for seed in range(episodes):
        pair.start(seed)
        rng = np.random.default_rng(seed)
        for _ in range(steps):
            anchor(pair)
            differences = pair.step(act(pair, rng))
            contacts += touching(pair.env)
            for kind, it in differences.items():
                found[kind].append((apart(pair, kind), it.reward, it.flag))
    return [row(name, kind, rows, contacts) for kind, rows in found.items()]


def row(
    name: str, kind: str, rows: list[tuple[float, float, bool]], contacts: int
) -> str:
    """Write a row of the table."""
    qpos, reward, flags = np.array(rows).T
    return (
        f"| {name} | {kind} | {qpos.size} | {contacts / qpos.size:.0%} | "
        f"{(qpos <= 1e-9).mean():.2%} | {qpos.max():.0e} | {reward.max():.0e} | "
        f"{flags.sum():.0f} |"
    )


def closeness(
    tasks: tuple[str, ...], domain: Domain, act: Act, episodes: int, steps: int
) -> None:
    """Measure, and print the table."""
    columns = "task, arithmetic, control steps, robot touches something, "
    columns += "within 1e-9, largest in qpos, largest in reward, "
    columns += "success flags that differ"
    print("| " + columns.replace(", ", " | ") + " |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for name in tasks:
        pair = make_pair(name, domain=domain)
        for text in anchored(pair, name, act, episodes, steps):
            print(text, flush=True)


def open_loop(name: str, domain: Domain, episodes: int, steps: int) -> Curves:
    """Return how far apart trajectories are, by what differs, each [episode, step]."""
    pair = make_pair(name, 2, domain)
    arm = pair.native["exact"].worlds.control.arm_qpos
    shape = (episodes, steps)
    curves = {kind: np.zeros(shape) for kind in (*KINDS, "nudged")}
    for seed in range(episodes):
        pair.start(seed)
        pair.native["exact"].data[1].qpos[arm[0]] += NUDGE
        rng = np.random.default_rng(seed)
        for step in range(steps):
            pair.step(random_action(pair, rng))
            for kind in KINDS:
                curves[kind][seed, step] = apart(pair, kind)
            curves["nudged"][seed, step] = apart(pair, "exact", copy=1)
    return curves


def parting(
    tasks: tuple[str, ...], domain: Domain, episodes: int, steps: int, out: str
) -> None:
    """Print how trajectories part, medians over episodes, and draw it."""
    marks = [mark for mark in MARKS if mark * RATE <= steps]
    columns = [*(f"{mark} s" for mark in marks), "at the end, worst episode"]
    print("| task | what differs | " + " | ".join(columns) + " |")
    print("|---|---|" + "---|" * len(columns), flush=True)
    found = {}
    for name in tasks:
        found[name] = open_loop(name, domain, episodes, steps)
        for kind, curve in found[name].items():
            medians = np.median(curve, axis=0)
            numbers = [
                *(medians[mark * RATE - 1] for mark in marks),
                curve[:, -1].max(),
            ]
            cells = " | ".join(f"{number:.0e}" for number in numbers)
            print(f"| {name} | {kind} | {cells} |", flush=True)
    if out:
        draw(found, episodes, Path(out))


def draw(found: dict[str, Curves], episodes: int, folder: Path) -> None:
    """Write the figure: medians over episodes, robosuite's tasks and rlco's."""
    from rlco.reporting.plot_style import QUIET, caption, new_figure, save_figure

    figure, panels = new_figure("How fast trajectories part", 2, height=3.6)
    for axis, ours in zip(panels, (False, True), strict=True):
        names = [name for name in found if (name in TASK_NAMES) == ours]
        for name, look in zip(names, LOOKS, strict=False):
            draw_task(axis, name, found[name], look)
        title = "rlco's tasks" if ours else "robosuite's tasks"
        axis.set_title(title, loc="left", fontsize=10)
        axis.set(yscale="log", ylim=(1e-17, 1), xlabel="time [s]", xlim=0)
        axis.set_yticks([1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
        axis.minorticks_off()
        axis.legend(frameon=False, fontsize=8.5, loc="upper left", ncols=2)
    panels[0].set_ylabel("largest difference [rad, m]")
    kinds = {"native, fast": "-", "robosuite, start 1e-15 rad aside": ":"}
    lines = [
        panels[0].plot([], [], dashes, color=QUIET)[0] for dashes in kinds.values()
    ]
    figure.legend(
        lines, kinds, loc="outside upper right", ncols=2, frameon=False, fontsize=9
    )
    caption(
        figure,
        f"Against robosuite, open loop, by the same random actions; medians over "
        f"{episodes} episodes. Both part alike. Native with exact=True never parts.",
    )
    save_figure(figure, folder / "open_loop.png")


def draw_task(axis: Any, name: str, curves: Curves, look: tuple[str, float]) -> None:
    """Draw a task's two lines; wide ones show beneath narrow ones on top of them."""
    for kind, dashes in (("fast", "-"), ("nudged", ":")):
        medians = np.median(curves[kind], axis=0)
        axis.plot(
            np.arange(1, medians.size + 1) / RATE,
            np.maximum(medians, 1e-17),
            dashes,
            color=look[0],
            linewidth=look[1],
            label=name if kind == "fast" else None,
        )


def check_tasks(tasks: tuple[str, ...], domain: Domain) -> None:
    """Refuse robosuite's tasks anywhere but in ``sim``: they have no domains."""
    theirs = [name for name in tasks if name not in TASK_NAMES]
    if theirs and domain != SIM:
        raise SystemExit(
            f"domain={domain.name} is not supported for robosuite's tasks {theirs}; "
            f"give tasks={','.join(TASK_NAMES)}."
        )


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    counts = int(given.get("episodes", 50)), int(given.get("steps", 200))
    place = make_domain(given.get("domain", "sim"))
    chosen = TASKS if place == SIM else TASK_NAMES
    if "tasks" in given:
        chosen = tuple(given["tasks"].split(","))
    check_tasks(chosen, place)
    if "open" in given:
        parting(chosen, place, *counts, given.get("out", ""))
    else:
        closeness(chosen, place, ACTIONS[given.get("actions", "random")], *counts)
