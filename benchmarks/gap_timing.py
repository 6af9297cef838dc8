"""How well hidden effects are named where a logger loses and smears time.

    python benchmarks/gap_timing.py out=outputs/gap_timing count=40

Each case of `gap_cases` is searched as a clean log and with each fault of `WAYS`, as
CSV files. The robot and its commands are the same; what differs is what was written
down, and for ``late_reads`` when rows were read.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gap_arms import Array, make_arm
from gap_cases import Case, make_case, plan
from gap_motions import MOTIONS, commands
from gap_naming import HERE, Book, in_order, read_truth
from gap_plant import Hidden, make_plant
from gap_recording import read_out, record
from gap_scoring import judge, share_of
from timed_process import run_timed

from rlco.run import run_recipe
from rlco.runs.config import option

#: Ways in which a log is faulty.
WAYS = ("clean", "lost", "stamps", "repeated", "two_rates", "late_reads", "all")
SEED = 21000  # of the first case
_LOST, _REPEATED, _JITTER = 0.05, 0.03, 0.2  # shares of rows, and of a period


@dataclass
class Config:
    """Options of gap_timing.py."""

    out: str = option("outputs/gap_timing", "folder; a finished case in it is kept")
    count: int = option(40, "cases, each in every way", minimum=1)
    seed: int = option(SEED, "seed of the first case", minimum=0)
    ways: list[str] = option(list(WAYS), "in which ways logs are faulty")
    groups: list[str] = option(["single", "pair"], "groups of cases")
    arms: list[str] = option([], "only cases of these robots")


def faulty(rows: dict[str, Array], way: str, random: Any) -> dict[str, Array]:
    """Return an episode's rows as a faulty logger writes them.

    Args:
        rows: ``time`` (T,), ``state``, ``action`` and perhaps ``velocity``.
        way: One of `WAYS`.
        random: What decides where.
    """
    rows, count = dict(rows), len(rows["time"])
    period = float(np.median(np.diff(rows["time"])))
    measured = [name for name in ("state", "velocity") if name in rows]
    source: Any = np.arange(count)
    if way in ("repeated", "all"):
        source[1:][random.random(count - 1) < _REPEATED] = 0
        source = np.maximum.accumulate(source)
    if way == "two_rates":
        source -= source % 2
    for name in measured:
        rows[name] = rows[name][source]
    if way in ("stamps", "all"):
        rows["time"] = rows["time"] + random.normal(0.0, _JITTER * period, count)
    kept = np.ones(count, dtype=bool)
    if way in ("lost", "all"):
        kept[1:-1] = random.random(count - 2) >= _LOST
    return {name: values[kept] for name, values in rows.items()}


def episodes(case: Case, truth: dict[str, Any], late: bool) -> Iterator[dict[str, Any]]:
    """Record the episodes of a case again, with rows read late or in time."""
    arm, motion = make_arm(case.arm), MOTIONS[case.motion]
    random = np.random.default_rng(case.seed)
    sent = [commands(arm, motion, random) for _ in range(motion.episodes)]
    hidden = [
        Hidden(e["name"], e["target"], e["parameters"], False) for e in truth["effects"]
    ]
    plant = make_plant(arm.xml, hidden, motion.jitter, case.seed)
    random = np.random.default_rng(case.seed + 1)
    for number, line in enumerate(sent):
        times = np.arange(len(line)) / motion.fps
        if late:
            times[1:] += random.normal(0.0, _JITTER / motion.fps, len(line) - 1)
            times = np.sort(np.maximum(times, 0.0))
        session = (number / len(sent), (number + 1) / len(sent))
        recorded = record(plant, line, motion.fps, random, session, times)
        logged = read_out(recorded, motion, random)
        rows = {name.split(".")[1]: values for name, values in logged.items()}
        yield {"time": times, "action": line, **rows}


def write_csv(path: Path, rows: dict[str, Array], joints: tuple[str, ...]) -> None:
    """Write an episode as one CSV file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    words = {"state": "position", "velocity": "velocity", "action": "command"}
    header, columns = ["time"], [rows["time"]]
    for name, word in words.items():
        if name in rows:
            header += [f"{word}.{joint}" for joint in joints]
            columns += list(rows[name].T)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(
            [[f"{v:.7g}" for v in row] for row in np.column_stack(columns)]
        )


def folders(case: Case, ways: list[str], out: Path) -> dict[str, Path]:
    """Make a case in the ways in which it is not there yet; return the folders."""
    source = out / "sources" / case.name
    if not (source / "truth.json").exists():
        make_case(case, source)
    truth, joints = read_truth(source), make_arm(case.arm).joints
    found = {way: out / "cases" / way / f"{case.name}-{way}" for way in ways}
    fresh = [way for way in ways if not (found[way] / "truth.json").exists()]
    kinds = {way == "late_reads" for way in fresh}
    recorded = {late: list(episodes(case, truth, late)) for late in kinds}
    for way in fresh:
        folder, random = found[way], np.random.default_rng([case.seed, WAYS.index(way)])
        for number, rows in enumerate(recorded[way == "late_reads"]):
            path = folder / "data" / f"episode{number}.csv"
            write_csv(path, faulty(rows, way, random), joints)
        (folder / "model.xml").write_text((source / "model.xml").read_text())
        (folder / "truth.json").write_text(json.dumps(truth))
    return found


def search(folder: Path) -> dict[str, Any]:
    """Search one folder in a process of its own."""
    command = [sys.executable, str(HERE / "gap_search_case.py"), str(folder)]
    done = run_timed(command, 3600.0, {"PYTHONPATH": str(HERE.parent)})
    if done.status:
        return {"name": folder.name, "failed": done.errors.strip().splitlines()[-1:]}
    answer = json.loads(done.output.strip().splitlines()[-1])
    return {"name": folder.name, "cpu": done.cpu, **answer}


def main(config: Config) -> None:
    """Search what is missing, then print how often each way is exact."""
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    book = Book(out / "results.jsonl")
    cases = plan(config.seed, config.groups)
    cases = in_order([c for c in cases if not config.arms or c.arm in config.arms])
    exact: dict[str, list[bool]] = {way: [] for way in config.ways}
    for case in cases[: config.count]:
        for way, folder in folders(case, config.ways, out).items():
            if folder.name not in book.rows:
                book.add(search(folder))
            row, truth = book.rows[folder.name], read_truth(folder)
            broken = {"verdict": "failed", "effects": [], **row}
            exact[way].append(judge(broken, truth).exact)
            named = [f"{e['name']} {e['target']}" for e in broken["effects"]]
            hidden = [f"{e['name']} {e['target']}" for e in truth["effects"]]
            mark = "exact" if exact[way][-1] else "-"
            print(
                f"{folder.name} | {hidden} | {mark} {broken['verdict']} {named}",
                flush=True,
            )
    print("| log | exact |\n|---|---|")
    for way, tests in exact.items():
        print(f"| {way} | {share_of(tests)} |")


if __name__ == "__main__":
    run_recipe(main, Config)
