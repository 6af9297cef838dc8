"""What changed between two recordings: cases, their results, and the table.

For `gap_reference` and `gap_task_reference`. Each finished case is one line in
``OUT/results.jsonl``: started again, a benchmark goes on where it was.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gap_plant import Hidden
from gap_scoring import share_of

from rlco.gap.compare.verdict import NamedEffect, Verdict
from rlco.runs.config import option

_SIZE = 0.15  # relative error that is wanted
Row = dict[str, Any]


@dataclass
class Config:
    """Options of a benchmark, which gives the defaults of the folder and the seed."""

    out: str = option("outputs/gap_changes", "folder; finished cases are kept")
    groups: list[str] = option([], "only cases of these groups")
    arms: list[str] = option([], "only cases of these robots or tasks")
    seed: int = option(0, "seed of the first case", minimum=0)
    minutes: float = option(600.0, "start no case after so many", minimum=0.0)
    every: int = option(1, "take every so many cases", minimum=1)


@dataclass(frozen=True)
class Case:
    """A case: the robot or the task, what changes, and whether that is of torques."""

    name: str
    group: str
    arm: str
    effects: tuple[str, ...]
    torques: bool
    seed: int


def row_of(case: Case, verdict: Verdict, hidden: Sequence[Hidden], shows: float) -> Row:
    """Return what was found beside the truth, judged.

    Args:
        case: The case.
        verdict: Of its search.
        hidden: What changed.
        shows: By how many times the noise that changes the same motion.
    """
    row: Row = {
        "name": case.name,
        "group": case.group,
        "verdict": verdict.verdict,
        "found": named(verdict.effects),
        "truth": true(hidden),
        "shows": round(shows, 2),
        "share": verdict.unexplained["share"],
        "doubt": None if verdict.free_form is None else verdict.free_form.target,
        "closest": [[c.name, c.target, s] for c, s in verdict.closest],
    }
    return row | judged(row)


def named(effects: Sequence[NamedEffect]) -> list[Row]:
    """Return named effects as a row of results has them."""
    return [
        {
            "name": one.name,
            "target": one.target,
            "values": {k: v.value for k, v in one.parameters.items()},
            "low": {k: v.low for k, v in one.parameters.items()},
            "high": {k: v.high for k, v in one.parameters.items()},
            "rivals": [[r.name, r.target] for r in one.rivals],
        }
        for one in effects
    ]


def true(hidden: Sequence[Hidden]) -> list[Row]:
    """Return hidden effects as a row of results has them."""
    return [
        {"name": h.name, "target": h.target, "values": dict(h.parameters)}
        for h in hidden
    ]


def judged(row: Row) -> Row:
    """Return whether the names are exact, and the relative errors of their sizes."""
    wanted = {(t["name"], t["target"]): t["values"] for t in row["truth"]}
    found = {(f["name"], f["target"]): f["values"] for f in row["found"]}
    in_class = all(
        any(
            key == (f["name"], f["target"]) or list(key) in f["rivals"]
            for f in row["found"]
        )
        for key in wanted
    )
    errors = []
    for key in wanted.keys() & found.keys():
        parameter, value = next(iter(wanted[key].items()))
        away = value - 1.0 if parameter == "factor" else value
        errors.append(abs(found[key][parameter] - value) / abs(away))
    exact = wanted.keys() == found.keys() if wanted else not found
    return {
        "exact": exact,
        "in_class": in_class and len(found) == len(wanted),
        "errors": errors,
        "sized": exact and all(error <= _SIZE for error in errors),
    }


def table(rows: Sequence[Row]) -> str:
    """Return the results in Markdown."""
    lines = [
        "| group | cases | names exact | or in the class | exact, size within 15 % "
        "| the same of those that show | exact, without rivals | named | doubted "
        "| median CPU s |",
        "|---" * 10 + "|",
    ]
    kinds = {row["group"]: None for row in rows}
    for group in kinds:
        inside = [row for row in rows if row["group"] == group]
        cells = [
            share_of([row[key] for row in inside])
            for key in ("exact", "in_class", "sized")
        ]
        # No recording can show what changes less than its noise.
        cells.append(share_of([row["sized"] for row in inside if row["shows"] >= 1.0]))
        sure = [not any(f["rivals"] for f in row["found"]) for row in inside]
        cells.append(
            share_of([a and row["exact"] for a, row in zip(sure, inside, strict=True)])
        )
        some = share_of([bool(row["found"]) for row in inside])
        doubted = share_of([row["doubt"] is not None for row in inside])
        seconds = float(np.median([row["cpu"] for row in inside]))
        lines.append(
            f"| {group} | {len(inside)} | {' | '.join(cells)} | {some} | "
            f"{doubted} | {seconds:.0f} |"
        )
    return "\n".join(lines)


def run(config: Config, cases: Sequence[Case], run_case: Callable[[Case], Row]) -> None:
    """Run those cases of a plan that are not there yet, and print the table."""
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    book = out / "results.jsonl"
    rows = (
        [json.loads(x) for x in book.read_text().splitlines()] if book.exists() else []
    )
    done = {row["name"] for row in rows}
    until = time.monotonic() + 60.0 * config.minutes
    for case in cases[:: config.every]:
        if config.groups and case.group not in config.groups:
            continue
        if config.arms and case.arm not in config.arms:
            continue
        if case.name in done or time.monotonic() > until:
            continue
        row = run_case(case)
        rows.append(row)
        with book.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(case.name, row["verdict"], row["exact"], row["errors"], flush=True)
    print(table(rows))
