"""Measure, for each column of the maps, how much sim teaches of the robot's part.

    uv run benchmarks/alignment_shares.py

The number is `cross` of recipes/align.py: the share of the real demonstrations' actions
that a small policy explains which has seen the simulated ones alone. It can be had
before any training, so that `align` can say which column of the maps one's own case is
near. Five seeds of each column, on the demonstrations of that column's own runs; some
25 minutes of a processor. What is measured already is kept.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlco.run import run_recipe
from rlco.runs.config import option
from rlco.runs.whole_files import write_text

if TYPE_CHECKING:
    from rlco.runs.compare.jobs import Job

ROOT = Path(__file__).parents[1]
EXPERIMENTS = ROOT / "benchmarks" / "experiments"
UPDATES = 300  # of align.py
HELD_OUT = 5  # one of so many simulated demonstrations is not trained on

log = logging.getLogger("rlco.alignment_shares")
Row = dict[str, Any]


@dataclass
class Config:
    """Options of alignment_shares.py."""

    out: str = option(
        "benchmarks/cells/alignment_shares.json", "file that gets a row each"
    )
    data: str = option("outputs/alignment_shares", "folder of recorded demonstrations")


def main(config: Config) -> None:
    """Measure what is missing, and write after each."""
    path = Path(config.out)
    rows: list[Row] = json.loads(path.read_text("utf-8")) if path.is_file() else []
    known = {(row["map"], row["column"], row["seed"]) for row in rows}

    def add(of: str, column: str, seed: int, cross: float) -> None:
        row = {"map": of, "column": column, "seed": seed, "cross": round(cross, 4)}
        rows.append(row)
        lines = ",\n".join(json.dumps(one) for one in rows)
        write_text(path, f"[\n{lines}\n]\n")
        log.info("%s, %s, seed %d: %.2f", of, column, seed, cross)

    for gap, seed in planar_columns():
        if ("planar", gap, seed) not in known:
            add("planar", gap, seed, planar_share(gap, seed))
    for real, sim in mujoco_columns():
        column, seed = f"yaw{real.values['yaw']}", int(real.values["seed"])
        if ("push_cube", column, seed) not in known:
            folders = [recorded(job, Path(config.data)) for job in (sim, real)]
            add("push_cube", column, seed, aligned(*folders))


# -- The planar task ---------------------------------------------------------------


def planar_columns() -> list[tuple[str, int]]:
    """Return gap and seed of each column of the planar map."""
    from rlco.runs.compare.reading.read_experiment import read_experiment

    over = read_experiment(EXPERIMENTS / "planar.yaml").over
    return [(str(gap), int(seed)) for gap in over["gap"] for seed in over["seed"]]


def planar_share(gap: str, seed: int) -> float:
    """Return how much of a gap's demonstrations the simulator's explain."""
    import tempfile

    from planar.demos import record
    from planar.env import CHUNK, PlanarTask
    from planar.gaps import SIM
    from planar_push import Config as Planar
    from planar_push import record as recorded_of

    from rlco.run import Run
    from rlco.training.alignment import explained
    from rlco.training.options.stage_one_options import StageOneOptions
    from rlco.training.stage_one import StageOneDemos, train_stage_one

    config = Planar(gap=gap, seed=seed)
    real = recorded_of(config)["real"]
    trained_on = config.sim_demos - config.sim_demos // HELD_OUT
    sim = record(SIM, trained_on, 500_000 + 3 * seed)
    options = StageOneOptions(
        seed=seed,
        task=PlanarTask.name,
        sim_ratio=1.0,
        chunk=CHUNK,
        updates=UPDATES,
        log_every=UPDATES,
    )
    data: Any = StageOneDemos(PlanarTask(), sim=sim, real=None)
    with tempfile.TemporaryDirectory() as folder:
        options.out = str(Path(folder, "run"))
        with Run(options, "sft") as run:
            policy = train_stage_one(options, run, data)
    return explained(policy, real.frames()).share


# -- push_cube in MuJoCo -----------------------------------------------------------


def mujoco_columns() -> list[tuple[Job, Job]]:
    """Return the recordings of each column: of the robot's part, and of sim."""
    from rlco.runs.compare.jobs import expand
    from rlco.runs.compare.reading.read_experiment import read_experiment

    jobs = expand(read_experiment(EXPERIMENTS / "alignment.yaml"))
    sims = {job.values["seed"]: job for job in jobs if job.kind.name == "sim"}
    return [(job, sims[job.values["seed"]]) for job in jobs if job.kind.name == "real"]


def recorded(job: Job, data: Path) -> Path:
    """Record what a job of the plan records, if it is not there; return its folder."""
    folder = data / job.name
    if not (folder / "meta" / "info.json").is_file():
        options = [f"{key}={value}" for key, value in job.options({}).items()]
        run(str(job.kind.path), f"out={folder}", *options)
    return folder


def aligned(sim: Path, real: Path) -> float:
    """Return what align.py measures of two data sets."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "align")
        given = [f"sim_demos={sim}", f"real_demos={real}", f"updates={UPDATES}"]
        run("recipes/align.py", *given, f"out={out}")
        found = json.loads((out / "alignment.json").read_text("utf-8"))
    return float(found["shares"]["cross"])


def run(script: str, *options: str) -> None:
    """Run a recipe, and stop where it fails."""
    subprocess.run([sys.executable, script, *options], check=True, cwd=ROOT)


if __name__ == "__main__":
    run_recipe(main, Config)
