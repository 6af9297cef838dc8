"""Train for long, and watch whether memory, threads, handles or files grow.

    OMP_NUM_THREADS=1 uv run benchmarks/soak.py minutes=480 out=docs/figures
    OMP_NUM_THREADS=1 uv run benchmarks/soak.py frames=2000000 num_envs=32
    OMP_NUM_THREADS=1 uv run benchmarks/soak.py task=planar frames=13000000

The recipe rl_co runs as its users run it: rollouts, updates, tables, TensorBoard and a
checkpoint after each, evaluations now and then. After each iteration this process and
its run folder are measured. The first fifth, in which caches fill, is not judged: of
the rest the slope of the memory is shown with its interval, and threads and handles
must stay. `FOLDER/soak.csv` holds every measurement, `FOLDER/soak.png` shows them; the
status is 1 if something grew.

With task=planar it is the task of benchmarks/planar, whose frames cost a twentieth:
all that training does, for many more frames, without MuJoCo (`FOLDER/soak_planar.*`).
"""

from __future__ import annotations

import csv
import importlib
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Any

import numpy as np

from rlco.run import run_recipe
from rlco.runs.checkpoints import checkpoint_files

RECIPES = Path(__file__).parents[1] / "recipes"
NAMES = ("frames", "minutes", "memory_mb", "threads", "handles", "folder_mb", "files")
#: Of the iterations, while caches fill.
WARM = 0.2
#: What the memory may grow by in eight hours' frames [MB].
MOST = 100.0
_MB = 2**20


def measured(frames: int, began: float, folder: Path) -> dict[str, float]:
    """Return what this process holds now, and its run's folder."""
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[1])
    sizes = list(sizes_in(folder))
    return {
        "frames": frames,
        "minutes": round((time.monotonic() - began) / 60, 3),
        "memory_mb": round(pages * os.sysconf("SC_PAGE_SIZE") / _MB, 2),
        "threads": len(os.listdir("/proc/self/task")),
        "handles": len(os.listdir("/proc/self/fd")),
        "folder_mb": round(sum(sizes) / _MB, 2),
        "files": len(sizes),
    }


def sizes_in(folder: Path) -> Iterator[int]:
    """Yield the size of each file, but of those that training takes away meanwhile."""
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):
            found = path.stat()
            if S_ISREG(found.st_mode):
                yield found.st_size


def train(
    place: Path, before: Callable[[Path], list[str]], given: dict[str, str]
) -> list[dict[str, float]]:
    """Train until as many minutes or frames are over; return the measurements."""
    sys.path.insert(0, str(RECIPES))
    minutes, frames = (float(given.pop(n, "inf")) for n in ("minutes", "frames"))
    if min(minutes, frames) == np.inf:
        minutes = 480.0
    training = [*before(place), "iterations=10000000", "eval_every=50"]
    training += ["eval_episodes=8", *(f"{k}={v}" for k, v in given.items())]
    rows: list[dict[str, float]] = []
    run, over = place / "run", threading.Event()
    watched = threading.Thread(target=watch, args=(run, rows, minutes, frames, over))
    watched.start()
    try:
        start(*training, f"out={run}")
    except SystemExit as end:
        if end.code != 128 + signal.SIGTERM:  # that is `watch`
            raise
    finally:
        over.set()
        watched.join()
    return rows


def start(recipe: str, *options: str) -> None:
    """Run a recipe in this process."""
    module: Any = importlib.import_module(recipe)
    run_recipe(module.main, module.Config, list(options))


def push_cube_before(place: Path) -> list[str]:
    """Record and imitate; return the recipe that comes after, and its options."""
    real, sft = place / "real", place / "sft"
    start("record_demos", "domain=stand_in", "episodes=2", f"out={real}")
    small = ("sim_ratio=0", "updates=200", "eval_episodes=0")
    start("sft", f"real_demos={real}", *small, f"out={sft}")
    return ["rl_co", f"policy={sft / 'policy'}", f"real_demos={real}"]


def planar_before(place: Path) -> list[str]:
    """Imitate on the plane; return the recipe that comes after, and its options."""
    one = place / "one"
    start("planar_push", "stage=one", "updates=200", "eval_episodes=8", f"out={one}")
    policy = one / "stages" / "sft" / "policy"
    return ["planar_push", "stage=two", f"policy={policy}"]


@dataclass(frozen=True)
class Training:
    """What is trained.

    Attributes:
        name: Of its files.
        title: Of its figure.
        before: What comes before; it returns the recipe that comes after.
        eight_hours: Frames, in millions, that are judged; None: as many as this
            machine does in eight hours.
    """

    name: str
    title: str
    before: Callable[[Path], list[str]]
    eight_hours: float | None = None


TRAININGS = {
    "push_cube": Training("soak", "rl_co, push_cube", push_cube_before),
    # As many as rl_co does on push_cube in eight hours of two AMD EPYC cores.
    "planar": Training("soak_planar", "stage two, planar task", planar_before, 12.5),
}


def watch(
    run: Path,
    rows: list[dict[str, float]],
    minutes: float,
    frames: float,
    over: threading.Event,
) -> None:
    """Measure after each checkpoint; end the training as Ctrl-C does.

    By SIGTERM: shells start what runs in the background without SIGINT.
    """
    began, last = time.monotonic(), -1
    try:
        while not over.wait(0.05):
            newest = max(checkpoint_files(run / "checkpoints"), default=-1)
            if newest == last:
                continue
            last = newest
            rows.append(measured(_frames(run / "metrics.csv"), began, run))
            if rows[-1]["minutes"] >= minutes or rows[-1]["frames"] >= frames:
                return
    finally:  # a training that nobody watches is of no use either
        if not over.is_set():
            os.kill(os.getpid(), signal.SIGTERM)


def _frames(table: Path) -> int:
    """Return the frames of a table's last whole row."""
    with table.open("rb") as file:
        names = file.readline().decode().strip().split(",")
        file.seek(max(file.tell(), table.stat().st_size - 4096))
        row = file.read().decode().rpartition("\n")[0].rpartition("\n")[2]
    return int(float(row.split(",")[names.index("frames")]))


def slope(rows: list[dict[str, float]], name: str) -> tuple[float, float]:
    """Return by how much something grows in a million frames, and how sure that is.

    Returns:
        The slope of least squares, and the half of its interval of 95 %, from blocks
        of a tenth each: neighbouring measurements are much alike.
    """
    frames = np.array([row["frames"] for row in rows]) / 1e6
    values = np.array([row[name] for row in rows])
    blocks = np.array_split(np.arange(len(rows)), 10)
    x = np.array([frames[block].mean() for block in blocks])
    y = np.array([values[block].mean() for block in blocks])
    fit, covariance = np.polyfit(x, y, 1, cov=True)
    return float(fit[0]), float(2.31 * np.sqrt(covariance[0, 0]))  # t, 8 of freedom


def draw(rows: list[dict[str, float]], judged: int, path: Path, title: str) -> None:
    """Draw memory, threads and handles over the frames."""
    from rlco.reporting.plot_style import caption, new_figure, save_figure

    figure, (left, right) = new_figure("A long training", 2, height=2.9)
    frames = [row["frames"] / 1e6 for row in rows]
    left.plot(frames, [row["memory_mb"] for row in rows])
    left.axvline(frames[judged], linestyle=":", color="0.6")
    left.set(xlabel="million frames", ylabel="memory [MB]", ylim=(0, None))
    for name in ("threads", "handles"):
        right.plot(frames, [row[name] for row in rows], label=name)
    right.set(xlabel="million frames", ylim=(0, None))
    right.legend(frameon=False)
    caption(figure, f"{title}, {len(rows)} iterations; judged from the line on")
    save_figure(figure, path)


def main() -> None:
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    out = Path(given.pop("out", "."))
    if (task := given.pop("task", "push_cube")) not in TRAININGS:
        sys.exit(f"task={task}: choose one of {', '.join(TRAININGS)}.")
    training = TRAININGS[task]
    with tempfile.TemporaryDirectory() as place:
        rows = train(Path(place), training.before, given)
    with (out / f"{training.name}.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, NAMES)
        writer.writeheader()
        writer.writerows(rows)
    judged = int(WARM * len(rows))
    draw(rows, judged, out / f"{training.name}.png", training.title)
    rest = rows[judged:]
    print(f"{len(rows)} iterations, {rows[-1]['frames']:.0f} frames, ", end="")
    print(f"{rows[-1]['minutes']:.0f} minutes; of the last four fifths:\n")
    print(
        "| | at first | at last | most | in a million frames |\n|---|---|---|---|---|"
    )
    grew = False
    for name in NAMES[2:]:
        values = [row[name] for row in rest]
        rate, unsure = slope(rest, name)
        print(f"| {name} | {values[0]:g} | {values[-1]:g} | {max(values):g} | ", end="")
        print(f"{rate:+.3g} ± {unsure:.2g} |")
        if name in ("threads", "handles"):
            grew |= max(values) > max(values[: len(values) // 2])
    rate, unsure = slope(rest, "memory_mb")
    here = 480 / rows[-1]["minutes"] * rows[-1]["frames"] / 1e6
    eight_hours = training.eight_hours or here
    print(f"\nIn eight hours' frames, {eight_hours:.1f} million: ", end="")
    print(f"{rate * eight_hours:+.0f} ± {unsure * eight_hours:.0f} MB.")
    grew |= (rate - unsure) * eight_hours > MOST
    sys.exit(int(grew))


if __name__ == "__main__":
    main()
