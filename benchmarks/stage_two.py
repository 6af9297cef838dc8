"""Frames a second of Stage II, collecting and learning, on both backends.

    uv run benchmarks/stage_two.py

Records a few demonstrations, trains Stage I for a moment, then runs recipes/rl_co.py on
each backend in turns, and prints what a rollout costs and where its time goes. The
policy learns little here: it is the time that counts.
"""

from __future__ import annotations

import csv
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from rlco.run import run_recipe
from rlco.runs.config import option

RECIPES = Path(__file__).parents[1] / "recipes"
BACKENDS = ("native", "robosuite")
Row = dict[str, float]


@dataclass
class Config:
    """Options of stage_two.py."""

    task: str = option("push_cube", "name of the task")
    num_envs: int = option(32, "episodes of a rollout", minimum=1)
    horizon: int = option(32, "control steps of an episode", minimum=1)
    iterations: int = option(3, "rollouts of a run; the first is not counted")
    turns: int = option(2, "runs of each backend", minimum=1)


def recipe(name: str, *options: str) -> None:
    """Run a recipe, quietly."""
    command = [sys.executable, str(RECIPES / f"{name}.py"), *options]
    subprocess.run(command, check=True, capture_output=True)


def prepare(config: Config, folder: Path) -> list[str]:
    """Record and imitate; return the options of Stage II."""
    demos, run = folder / "demos", folder / "sft"
    task = f"task={config.task}"
    recipe("record_demos", f"out={demos}", task, "domain=stand_in", "episodes=3")
    few = ("updates=50", "eval_episodes=0", "sim_ratio=0")
    recipe("sft", f"out={run}", task, f"real_demos={demos}", *few)
    return [task, f"policy={run / 'policy'}", f"real_demos={demos}"]


def stage_two(config: Config, options: list[str], out: Path, backend: str) -> list[Row]:
    """Run Stage II; return its timings, without the first rollout's."""
    size = [f"num_envs={config.num_envs}", f"horizon={config.horizon}"]
    more = [*size, f"iterations={config.iterations + 1}", "eval_episodes=0"]
    recipe("rl_co", f"out={out}", f"backend={backend}", *options, *more)
    with (out / "timings.csv").open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    return rows[1:]


def main(config: Config) -> None:
    """Measure and print."""
    rows: dict[str, list[Row]] = {backend: [] for backend in BACKENDS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = prepare(config, folder)
        for turn in range(config.turns):
            for backend in BACKENDS:
                out = folder / f"{backend}{turn}"
                rows[backend] += stage_two(config, options, out, backend)
    rate = {
        backend: statistics.median(row["frames_per_second"] for row in rows[backend])
        for backend in BACKENDS
    }
    print("| backend | collect [s] | learn [s] | frames a second | times robosuite |")
    print("|---|---|---|---|---|")
    for backend in BACKENDS:
        collect, learn = (
            statistics.median(row[part] for row in rows[backend])
            for part in ("collect", "learn")
        )
        times = rate[backend] / rate["robosuite"]
        print(
            f"| {backend} | {collect:.2f} | {learn:.2f} | {rate[backend]:.0f} | "
            f"{times:.2f} |"
        )


if __name__ == "__main__":
    run_recipe(main, Config)
