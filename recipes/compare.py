"""Run a grid of runs that one YAML file describes, and tabulate what they came to.

    uv run recipes/compare.py experiment=benchmarks/experiments/planar.yaml dry=true
    uv run recipes/compare.py experiment=benchmarks/experiments/planar.yaml hours=6
    uv run recipes/compare.py experiment=... only=[seed=10,task=push_cube]
    uv run recipes/compare.py experiment=... cells=benchmarks/cells/planar hours=0
    uv run recipes/compare.py experiment=... launch=ray ray_address=auto jobs=64

Every job is cached by what decides its result: script, options, code. Started again it
goes on where it was; with hours=0 it makes the tables of what there is.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rlco.errors import ConfigError, RlcoError, printable
from rlco.reporting.experiments.comparison import (
    comparison_table,
    cost_table,
    overview_table,
    prediction_runs,
    prediction_table,
)
from rlco.reporting.experiments.drift import drift_table, drifts_of
from rlco.reporting.experiments.entries import curves_of
from rlco.reporting.experiments.group_means import mean_table
from rlco.reporting.experiments.prediction_figure import prediction_figure
from rlco.reporting.experiments.results import made_by, result_rows, table_entries
from rlco.reporting.experiments.success_over import success_over
from rlco.reporting.plots import learning_curves, save_figure
from rlco.run import run_recipe
from rlco.runs import run_folder
from rlco.runs.compare.cells import Store
from rlco.runs.compare.experiment import Experiment
from rlco.runs.compare.forked_processes import ForkedProcesses
from rlco.runs.compare.jobs import Job, expand
from rlco.runs.compare.only import only
from rlco.runs.compare.plan import Plan, expected_minutes, make_plan
from rlco.runs.compare.processes import LocalProcesses, Processes
from rlco.runs.compare.queue import Queue
from rlco.runs.compare.reading.read_experiment import read_experiment
from rlco.runs.compare.smallest import smallest
from rlco.runs.config import REQUIRED, option
from rlco.runs.ray_cluster import check_ray
from rlco.runs.whole_files import write_json, write_text

log = logging.getLogger("rlco.compare")


@dataclass
class Config:
    """Options of compare.py."""

    experiment: str = option(REQUIRED, "YAML file of the experiment")
    out: str | None = option(
        None, "folder of jobs and tables, gone on with; null: outputs/compare/NAME"
    )
    cells: str | None = option(
        None, "folder of small result files to commit: read, and added to"
    )
    code: Literal["same", "any"] = option(
        "same", "any: use results of another version of the code, marked"
    )
    jobs: int = option(2, "jobs at once, one thread each", minimum=1)
    launch: Literal["local", "ray"] = option(
        "local", "where jobs run: on this machine, or on the nodes of a Ray cluster"
    )
    ray_address: str | None = option(
        None, "ray: the cluster, auto or HOST:PORT; null: one of this machine alone"
    )
    hours: float | None = option(
        None, "start no further job after so long [h]; 0: tables alone", minimum=0
    )
    nice: int = option(10, "niceness of the jobs", minimum=0, maximum=19)
    only: list[str] = option(
        [], "jobs of these values alone, [NAME=VALUE,...]; the tables are of all"
    )
    smallest: bool = option(
        False, "one value of each variable and short jobs: whether all of it runs"
    )
    dry: bool = option(False, "say what would run and how long it would take")


def main(config: Config) -> None:
    """Plan, run what is missing, and write the tables."""
    path = Path(config.experiment)
    experiment = read_experiment(path)
    if config.smallest:
        check_smallest(config)
        experiment = smallest(experiment)
    name = experiment.name + ("-smallest" if config.smallest else "")
    out = Path(config.out or Path("outputs", "compare", name))
    jobs = expand(experiment)
    store = Store(out, config.cells and Path(config.cells), config.code)
    plan = make_plan(only(jobs, experiment, config.only), store)
    check_launch(config)
    say(plan, store, config.jobs)
    if config.dry:
        return
    store.check()
    processes = processes_of(config)
    lock = run_folder.lock(out)
    failed: set[Job] = set()
    try:
        queue = Queue(plan, store, config.jobs, config.hours, config.nice, processes)
        failed = queue.run()
    finally:
        processes.close()
        # What there is when it is interrupted makes a table, too.
        save(experiment, jobs, store, out)
        os.close(lock)
    if failed:  # so that scripts around this one hear of it
        raise RlcoError(
            f"{len(failed)} of {len(plan.every)} jobs failed; all others are in the "
            "table, and the same command tries these again."
        )


def check_smallest(config: Config) -> None:
    """Check that results which mean nothing are not kept beside others.

    Raises:
        ConfigError: They would be.
    """
    if config.cells is not None:
        raise ConfigError(
            [
                f"cells={config.cells} with smallest=true would keep results that mean "
                "nothing; leave one of them out"
            ]
        )


def check_launch(config: Config) -> None:
    """Check that jobs can run where they are to run.

    Raises:
        ConfigError: They cannot.
    """
    if config.launch == "ray":
        check_ray(config.ray_address)
    elif config.ray_address is not None:
        raise ConfigError(
            ["ray_address belongs to launch=ray, but launch=local; give launch=ray"]
        )


def processes_of(config: Config) -> Processes:
    """Return where jobs run."""
    if config.launch == "local":
        return ForkedProcesses() if config.smallest else LocalProcesses()
    from rlco.runs.compare.ray_processes import RayProcesses

    return RayProcesses(config.ray_address, config.jobs)


def say(plan: Plan, store: Store, at_once: int) -> None:
    """Say what will run, how much of it, and how long it will take."""
    minutes, measured = expected_minutes(plan.every, store)
    for name, each in minutes.items():
        every = [job for job in plan.every if job.kind.name == name]
        left = [job for job in plan.jobs if job.kind.name == name]
        log.info(
            "%s: %d of %d jobs to run, %.1f minutes each (%s)",
            name,
            len(left),
            len(every),
            each,
            "measured" if name in measured else "expected",
        )
    if older := store.others(plan.jobs):
        log.info(
            "%d of them have results of another version of the code; code=any uses "
            "those",
            older,
        )
    hours = plan.hours(plan.jobs, store, at_once)
    log.info("%.1f hours, %d jobs at once", hours, at_once)


def save(experiment: Experiment, jobs: Sequence[Job], store: Store, out: Path) -> None:
    """Write results.json, table.md and curves, and print the tables."""
    table = experiment.table
    entries = table_entries(experiment, jobs, store)
    several = len({entry.group for entry in entries}) > 1
    # Means that others reported name no variable that ours are over.
    of_means = [
        p for p in table.published if table.mean and not {*table.mean} & {*p.at}
    ]
    beside = [one for one in table.published if one not in of_means]
    text = ""
    if several or beside:
        text += overview_table(entries, table.differences, beside) + "\n"
    text += comparison_table(entries, table.differences)
    if table.mean:
        text += mean_table(entries, table.differences, table.mean, of_means)
    text += prediction_table(entries, table.predictions)
    text += drift_table(entries, table.differences)
    text += cost_table(entries) + made_by(jobs, store)
    write_json(out / "results.json", {"rows": result_rows(jobs, store)})
    write_text(out / "table.md", text)
    for group in dict.fromkeys(entry.group for entry in entries):
        mine = [entry for entry in entries if entry.group == group]
        if curves := curves_of(mine, table.curve_episodes):
            name = re.sub(r"[^\w.+-]+", "-", f"curves {group}".strip())
            figure = learning_curves(curves, drifts_of(mine), group=group)
            save_figure(figure, out / "plots" / f"{name}.png")
    if table.axis is not None:
        for name, figure in success_over(entries, table.axis).items():
            name = re.sub(r"[^\w.+-]+", "-", f"{table.axis} {name}".strip())
            save_figure(figure, out / "plots" / f"{name}.png")
    for number, prediction in enumerate(table.predictions, 1):
        figure = prediction_figure(
            prediction_runs(entries, prediction),
            prediction.gain,
            prediction.falls_with,
            prediction.domain,
        )
        save_figure(figure, out / "plots" / f"prediction {number}.png")
    print(printable(text))
    log.info("table: %s", out / "table.md")


if __name__ == "__main__":
    run_recipe(main, Config, loads="rlco.run")
