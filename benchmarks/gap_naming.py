"""How well hidden effects are named: 409 cases of our own making, and others' answers.

    python benchmarks/gap_naming.py out=outputs/gap_naming            # ten minutes
    python benchmarks/gap_naming.py out=outputs/gap_naming all=true   # everything

Run it with OMP_NUM_THREADS=1. Each case (`gap_cases`) is recorded from a plant that
shares no code with the search, and searched in a process of its own that gets the
model and the recordings, not the truth. Each finished case is one line in
``OUT/results.jsonl``: started again it goes on where it was, and the tables are of what
is there. Cases come in an order in which any first part holds all groups, so that ten
minutes give a small sample of everything.

Beside it, on as many cases as are asked for: the plain greedy search that a user can
write in an afternoon, and mujoco.sysid, given the right effects and with the usual list
(`gap_sysid`).

`extra` takes folders of further cases in the same form, made elsewhere.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gap_baselines import NAIVE, hidden_of, left, naive, read_case, split
from gap_cases import BENCHMARK_SEED, Case, make_case, plan
from gap_likelihood import evidence
from gap_scoring import Answered, judge, table
from timed_process import run_timed

from rlco.run import run_recipe
from rlco.runs.config import option

HERE = Path(__file__).parent
_LONGEST = 3600.0  # [s] for one case
Row = dict[str, Any]


@dataclass
class Config:
    """Options of gap_naming.py."""

    out: str = option("outputs/gap_naming", "folder; a finished case in it is kept")
    minutes: float = option(
        10.0, "start no case after so many; each side has its own", minimum=0.0
    )
    all: bool = option(False, "no limit of time, and all baselines; hours")
    groups: list[str] = option([], "only cases of these groups")
    arms: list[str] = option([], "only cases of these robots")
    naive: int = option(0, "cases that the greedy baseline runs too", minimum=0)
    naive_limit: float = option(600.0, "seconds that it gets for a case", minimum=1.0)
    sysid: int = option(0, "single effects that mujoco.sysid fits too", minimum=0)
    seed: int = option(BENCHMARK_SEED, "seed of the first case", minimum=0)
    jobs: int = option(
        1, "cases at a time; more than one spoils the seconds", minimum=1
    )
    extra: list[str] = option([], "folders of further case folders")


class Book:
    """A file of finished rows, one a line, that survives an interruption."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, Row] = {}
        if path.exists():
            lines = path.read_text().splitlines()
            self.rows = {row["name"]: row for row in map(json.loads, lines)}

    def add(self, row: Row) -> None:
        """Write a row at once."""
        self.rows[row["name"]] = row
        with self.path.open("a") as file:
            file.write(json.dumps(row) + "\n")


def in_order(cases: Sequence[Case]) -> list[Case]:
    """Return cases so that any first part holds all groups in proportion."""
    sizes: dict[str, int] = {}
    places = []
    for case in cases:
        sizes[case.group] = sizes.get(case.group, 0) + 1
        places.append(sizes[case.group] - 0.5)
    keyed = zip(places, cases, strict=True)
    return [
        c for _, c in sorted(keyed, key=lambda k: (k[0] / sizes[k[1].group], k[1].name))
    ]


def chosen(config: Config) -> list[Case]:
    """Return the cases that were asked for, in order."""
    cases = plan(config.seed, config.groups)
    return in_order([c for c in cases if not config.arms or c.arm in config.arms])


def folders(config: Config) -> Iterator[Path]:
    """Make cases that are not there yet, and yield the folder of each in turn."""
    for case in chosen(config):
        folder = Path(config.out) / "cases" / case.group / case.name
        if not (folder / "truth.json").exists():
            make_case(case, folder)
        yield folder
    for root in config.extra:
        for truth in sorted(Path(root).rglob("truth.json")):
            yield truth.parent


def read_truth(folder: Path) -> Row:
    """Return a case's truth; what cases made elsewhere do not tell has defaults."""
    truth = json.loads((folder / "truth.json").read_text())
    defaults = {"group": folder.parent.name, "exclude": [], "invisible": []}
    effects = [{"parameters": {}, **effect} for effect in truth["effects"]]
    return {**defaults, "severity": 1.0, **truth, "effects": effects}


def search(folder: Path) -> Row:
    """Search a case without its truth, in another process; return its answer."""
    truth = read_truth(folder)
    with tempfile.TemporaryDirectory() as apart:
        hidden_from = Path(apart) / "case"
        shutil.copytree(folder, hidden_from, ignore=shutil.ignore_patterns("truth*"))
        command = [sys.executable, str(HERE / "gap_search_case.py"), str(hidden_from)]
        command.append(f"exclude={','.join(truth['exclude'])}")
        done = _run(command)
    if "failed" not in done and truth["group"] == "single":
        logged = read_case(folder)
        named = [
            {**e, "parameters": {k: v["value"] for k, v in e["parameters"].items()}}
            for e in done["effects"]
        ]
        _, held = split(len(logged.positions))
        done["left"] = left(logged, hidden_of(named), held)
    if "failed" not in done and truth["group"] == "leave_out":
        done |= evidence(read_case(folder), done["effects"], truth)
    return {"name": folder.name, **done}


def fit_sysid(folder: Path) -> Row:
    """Fit a case with mujoco.sysid, in another process."""
    done = _run([sys.executable, str(HERE / "gap_sysid.py"), str(folder)])
    return {"name": folder.name, **done}


def _run(command: Sequence[str]) -> Row:
    done = run_timed(command, _LONGEST, {"PYTHONPATH": str(HERE.parent)})
    if done.status:
        said = done.errors.strip().splitlines()[-1:] or [f"status {done.status}"]
        return {"failed": said[0], "seconds": done.seconds, "cpu": done.cpu}
    answer = dict(json.loads(done.output.strip().splitlines()[-1]))
    return {"seconds": done.seconds, **answer, "cpu": done.cpu}


def fill(
    book: Book, there: Iterator[Path], work: Callable[[Path], Row], config: Config
) -> None:
    """Do the work on each folder that the book has no row of, until the time is up."""
    until = time.monotonic() + (float("inf") if config.all else 60 * config.minutes)
    fresh = (folder for folder in there if folder.name not in book.rows)
    one_by_one = threading.Lock()

    def take() -> None:
        while time.monotonic() < until:
            with one_by_one:  # making the next case, too
                folder = next(fresh, None)
            if folder is None:
                return
            row = work(folder)
            with one_by_one:
                book.add(row)
                print(_line(folder, row), flush=True)

    with ThreadPoolExecutor(config.jobs) as pool:
        for worker in [pool.submit(take) for _ in range(config.jobs)]:
            worker.result()


def _line(folder: Path, row: Row) -> str:
    if "failed" in row or "timeout" in row:
        return f"{folder.name}: {row.get('failed', 'ran out of time')}"
    truth = read_truth(folder)
    hidden = [f"{e['name']} {e['target'] or ''}".strip() for e in truth["effects"]]
    parts = [folder.name, "hidden: " + (", ".join(hidden) or "nothing")]
    if "verdict" in row:
        found = [f"{e['name']} {e['target'] or ''}".strip() for e in row["effects"]]
        score = judge(row, truth)
        mark = "exact" if score.exact else "class" if score.fine else "-"
        parts += [mark, f"{row['verdict']}: {', '.join(found)}"]
    return " | ".join([*parts, f"{row.get('seconds', 0):.0f} s"])


def answered(config: Config, book: Book, others: Sequence[Book]) -> list[Answered]:
    """Return all finished cases, judged; those that failed count as wrong."""
    out = []
    roots = [Path(config.out) / "cases", *map(Path, config.extra)]
    for path in sorted(p for root in roots for p in root.rglob("truth.json")):
        name = path.parent.name
        row, truth = book.rows.get(name), read_truth(path.parent)
        if row is None or (config.groups and truth["group"] not in config.groups):
            continue
        broken = {"verdict": "failed", "effects": [], **row}
        beside = [other.rows.get(name) for other in others]
        out.append(Answered(truth, judge(broken, truth), row, beside[0], beside[1]))
    return out


def main(config: Config) -> None:
    """Run what is missing, then print the tables of all that is there."""
    out = Path(config.out)
    out.mkdir(parents=True, exist_ok=True)
    names = ("results", "naive", "sysid")
    ours, greedy, fitted = (Book(out / f"{name}.jsonl") for name in names)
    fill(ours, folders(config), search, config)
    rich = [f for f in folders_there(config, ours) if read_truth(f)["fps"] == 50]
    if not NAIVE.exists():
        print(f"no greedy baseline: {NAIVE.name} is not there")
    else:
        some = rich[: config.naive or (60 if config.all else 0)]

        def beside(folder: Path) -> Row:
            return naive(folder, config.naive_limit)

        fill(greedy, iter(some), beside, config)
    single = [f for f in rich if read_truth(f)["group"] == "single"]
    some = single[: config.sysid or (len(single) if config.all else 0)]
    fill(fitted, iter(some), fit_sysid, config)
    text = table(answered(config, ours, (greedy, fitted)))
    (out / "table.md").write_text(text + "\n")
    print(text)


def folders_there(config: Config, book: Book) -> list[Path]:
    """Return the folders of finished cases, in the order of the list."""
    order = [case.name for case in chosen(config)]
    there = {
        path.parent.name: path.parent
        for path in (Path(config.out) / "cases").rglob("truth.json")
    }
    return [there[name] for name in order if name in book.rows and name in there]


if __name__ == "__main__":
    run_recipe(main, Config)
