"""Whether the motion that is proposed tells rivals apart: record it, and search again.

    python benchmarks/gap_record_next.py out=outputs/gap_naming [groups=[single_demo]]

Run it with OMP_NUM_THREADS=1, after ``gap_naming.py out=...``: of its cases it takes
those whose answer left rivals, sends the first proposed motion to the plant that made
the case, adds the recording, cut into four of five seconds so that some of it is held
out, and searches once more. Where no motion is said to tell rivals apart, that is
counted. Prints a table; one line a case goes to
``OUT/record_next.jsonl``, and started again it goes on.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gap_arms import Array
from gap_baselines import hidden_of
from gap_cases import in_session
from gap_motions import MOTIONS
from gap_naming import Book, read_truth
from gap_recording import read_out
from gap_scoring import judge, share_of
from gap_search_case import answer

from rlco.gap.diagnose.proposals import NO_MOTION
from rlco.gap.diagnose.record_next import Motion, recommend
from rlco.gap.logs import read_log
from rlco.gap.logs.log import Log, Recording
from rlco.gap.make_problem import make_problem
from rlco.gap.model import load_model
from rlco.gap.search.find_gap import find_gap
from rlco.run import run_recipe
from rlco.runs.config import option

_PARTS = 4
_NONE: dict[str, list[Any]] = {"effects": []}
Row = dict[str, Any]


@dataclass
class Config:
    """Options of gap_record_next.py."""

    out: str = option("outputs/gap_naming", "folder of gap_naming.py's results")
    groups: list[str] = option(["single_demo"], "of these groups")
    minutes: float = option(30.0, "start no case after so many", minimum=0.0)


def unclear(config: Config, found: Book) -> list[Path]:
    """Return the folders of cases whose answer left rivals."""
    folders = sorted((Path(config.out) / "cases").rglob("truth.json"))
    return [
        path.parent
        for path in folders
        if read_truth(path.parent)["group"] in config.groups
        and any(e["rivals"] for e in found.rows.get(path.parent.name, _NONE)["effects"])
    ]


def recorded(
    folder: Path, motion: Motion, commands: Array, names: tuple[str, ...]
) -> list[Recording]:
    """Send a motion to the plant of a case; return what is logged, in parts."""
    truth = read_truth(folder)
    session = in_session(truth["arm"], truth["motion"], truth["seed"])
    order = [motion.names.index(name) for name in names]
    sent = commands[:, order]
    played = session.play(hidden_of(truth["effects"]), sent, motion.fps)
    random = np.random.default_rng(truth["seed"] + 2)
    told = read_out(played, MOTIONS[truth["motion"]], random)
    parts = []
    for number, rows in enumerate(np.array_split(np.arange(len(sent)), _PARTS)):
        velocity = told.get("observation.velocity")
        parts.append(
            Recording(
                f"{motion.name} {number}",
                (rows - rows[0]) / motion.fps,
                told["observation.state"][rows],
                None if velocity is None else velocity[rows],
                sent[rows],
            )
        )
    return parts


def closed(folder: Path) -> Row:
    """Search a case, record what is proposed, and search both recordings."""
    began, truth = time.perf_counter(), read_truth(folder)
    loaded = load_model(folder / "model.xml")
    log = read_log(folder / "data", loaded)
    problem = make_problem(loaded, log)
    first = find_gap(problem)
    proposed = recommend(problem, first)
    motions = [(m, m.commands) for m in proposed if m.commands is not None]
    row: Row = {"name": folder.name, "before": answer(first), "motion": None}
    row["no_motion"] = [m.name for m in proposed if m.name.startswith(NO_MOTION)]
    if motions:
        more = [
            part
            for motion, commands in motions
            for part in recorded(folder, motion, commands, log.actuators)
        ]
        both = Log((*log.recordings, *more), log.joints, log.actuators)
        second = find_gap(make_problem(loaded, both))
        names = " and ".join(motion.name for motion, _ in motions)
        row |= {"motion": names, "after": answer(second)}
        row["exact"] = judge(row["after"], truth).exact
    return row | {"seconds": round(time.perf_counter() - began, 1)}


def members(said: Row) -> str:
    """Return the classes of an answer, in words."""
    classes = [
        " or ".join(f"{e['name']} {e['target'] or ''}".strip() for e in (one, *others))
        for one in said["effects"]
        for others in [one["rivals"]]
    ]
    return "; ".join(classes) or said["verdict"]


def main(config: Config) -> None:
    """Run what is missing, and print the table."""
    out = Path(config.out)
    book = Book(out / "record_next.jsonl")
    folders = unclear(config, Book(out / "results.jsonl"))
    until = time.monotonic() + 60 * config.minutes
    for folder in folders:
        if folder.name not in book.rows and time.monotonic() < until:
            book.add(json.loads(json.dumps(closed(folder), default=str)))
    rows = [book.rows[f.name] for f in folders if f.name in book.rows]
    print("| case | said of the demonstrations | motion | said with it | exact |")
    print("|---|---|---|---|---|")
    for row in rows:
        after = members(row["after"]) if row["motion"] else "-"
        motion = row["motion"] or ("none can" if row["no_motion"] else "-")
        cells = [row["name"], members(row["before"]), motion, after]
        print("| " + " | ".join([*cells, "yes" if row.get("exact") else "no"]) + " |")
    unclear_before = [
        row for row in rows if any(e["rivals"] for e in row["before"]["effects"])
    ]
    alone = [
        bool(row["motion"])
        and bool(row["after"]["effects"])
        and not any(e["rivals"] for e in row["after"]["effects"])
        for row in unclear_before
    ]
    # They count above as not made single.
    none_can = [bool(row["no_motion"]) and not row["motion"] for row in unclear_before]
    print(f"\nclasses that one motion makes single: {share_of(alone)}, wanted 90 %")
    print(f"classes that no motion is said to make single: {share_of(none_can)}")


if __name__ == "__main__":
    run_recipe(main, Config)
