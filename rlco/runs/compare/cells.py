"""Finished jobs as small files: what was run, by which code, and what came of it."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from rlco.errors import DataError, RlcoError
from rlco.files import Fields, read_json, shown
from rlco.runs.compare.jobs import Job
from rlco.runs.metrics import read_metrics
from rlco.runs.results_file import read_results, result_rows
from rlco.runs.whole_files import write_text

#: Columns of metrics.csv that begin with this only an evaluation fills, but for one.
EVALUATED, ROLLOUT = "success_", "success_rollout"
_DIGITS = 5  # of a curve's numbers: enough to draw and compare, short enough to commit


@dataclass(frozen=True)
class Cell:
    """One finished job.

    Attributes:
        name: What it is called where people read it.
        key: Of all that decides its result, see `Job.key`.
        identity: The same whatever the code.
        code: The version of the code.
        script: What was run.
        options: With what, folders of other jobs as their keys.
        rows: Of its results.json.
        curves: The evaluations on its way, by the table they are from.
        cpu_seconds: On the processor, all attempts together [s].
        attempts: How often it was started.
        processor: The processor's model.
        commit: The git commit of rlco; None where there is none.
        versions: Of the libraries.
        finished: When.
        began_from: What the jobs it goes on from had come to, see `outcome`, by their
            keys. Rounding differs between processors, so that one that is run again
            for its folder alone may come to something else than its cell shows.
    """

    name: str
    key: str
    identity: str
    code: str
    script: str
    options: dict[str, str]
    rows: list[dict[str, Any]]
    curves: dict[str, list[dict[str, float]]] = field(default_factory=dict)
    cpu_seconds: float = 0.0
    attempts: int = 1
    processor: str = ""
    commit: str | None = None
    versions: dict[str, str] = field(default_factory=dict)
    finished: str = ""
    began_from: dict[str, str] = field(default_factory=dict)

    def write(self, path: Path) -> None:
        """Write it to a file, one row a line."""
        content = asdict(self)
        lines = [f"{json.dumps(name)}: {_lines(v)}" for name, v in content.items()]
        write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")


def _lines(value: Any) -> str:
    if isinstance(value, list) and value:
        return "[\n  " + ",\n  ".join(map(_compact, value)) + "\n]"
    if isinstance(value, dict) and any(isinstance(v, list) for v in value.values()):
        parts = [f"{json.dumps(name)}: {_lines(v)}" for name, v in value.items()]
        return "{" + ",\n".join(parts) + "}"
    return _compact(value)


def _compact(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"))


def read_cell(path: Path) -> Cell:
    """Read a cell.

    Raises:
        DataError: It is no cell.
    """
    found = read_json(path, advice="take it away")
    unknown = found.content.keys() - {each.name for each in fields(Cell)}
    if unknown:
        raise DataError(
            f"{found.place} is no cell: it holds {shown(sorted(unknown)[0])} too; take "
            "it away."
        )
    return Cell(
        name=found.text("name"),
        key=found.text("key"),
        identity=found.text("identity"),
        code=found.text("code"),
        script=found.text("script"),
        options=_texts(found, "options"),
        rows=result_rows(found),
        curves=_curves(found),
        cpu_seconds=found.number("cpu_seconds", 0.0),
        attempts=found.integer("attempts", 1),
        processor=found.text("processor", ""),
        commit=found.text("commit", None),
        versions=_texts(found, "versions"),
        finished=found.text("finished", ""),
        began_from=_texts(found, "began_from"),
    )


def _texts(found: Fields, key: str) -> dict[str, str]:
    group = found.group(key)
    return {name: group.text(name) for name in group.content}


def _curves(found: Fields) -> dict[str, list[dict[str, float]]]:
    tables = found.group("curves")
    return {
        table: [_numbers(row) for row in tables.groups(table)]
        for table in tables.content
    }


def _numbers(row: Fields) -> dict[str, float]:
    for name, value in row.content.items():
        # NaN too: a table has what was measured, also where that is no number.
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise row.refuse(name, "a number")
    return dict(row.content)


def results(run: Path) -> list[dict[str, Any]]:
    """Return the rows of a run folder's results.json.

    Raises:
        DataError: There are none, or they are no counts of successes.
    """
    path = run / "results.json"
    rows = read_results(path)
    if not rows:
        raise DataError(f"{str(path)!r} has no rows of results.")
    return rows


def curves(run: Path, patterns: Iterable[str]) -> dict[str, list[dict[str, float]]]:
    """Return the rows with an evaluation of the tables in a run folder."""
    found = {}
    for path in sorted({path for pattern in patterns for path in run.glob(pattern)}):
        rows = [
            {name: float(f"{value:.{_DIGITS}g}") for name, value in row.items()}
            for row in read_metrics(path)
            if any(name.startswith(EVALUATED) and name != ROLLOUT for name in row)
        ]
        if rows:
            found[str(path.relative_to(run))] = rows
    return found


def outcome(rows: Iterable[dict[str, Any]]) -> str:
    """Return what tells results apart: a hash of what was solved, whatever it took."""
    names = ("method", "domain", "variation", "successes", "outcomes")
    told = [[row.get(name) for name in names] for row in rows]
    return hashlib.sha256(_compact(told).encode()).hexdigest()[:16]


#: How a cell's options name the job that it read.
_NEEDED = re.compile(r"job:([0-9a-f]+)")


class Store:
    """Cells, by what they are of: those of a folder to commit, and those of runs.

    Args:
        out: Where jobs run, each in a folder of its own.
        cells: A folder of cells to commit, which gets the new ones; or None.
        code: ``same``: cells of another version of the code are not used; ``any``:
            where there is none of this version, the latest one is.
    """

    def __init__(
        self, out: Path, cells: Path | None, code: Literal["same", "any"] = "same"
    ) -> None:
        self.jobs = out / "jobs"
        self.cells = cells
        self._any = code == "any"
        own = [read_cell(path) for path in sorted(self.jobs.glob("*/cell.json"))]
        given: list[Cell] = []
        if cells is not None:
            given = [read_cell(path) for path in sorted(cells.rglob("*.json"))]
        # The first result stands: one that was committed before one that was rerun.
        self._by_key = {cell.key: cell for cell in [*own, *given]}

    def find(self, job: Job) -> Cell | None:
        """Return the cell of a job; None where there is none that may be used."""
        if (cell := self._by_key.get(job.key)) is not None or not self._any:
            return cell
        alike = [c for c in self._by_key.values() if c.identity == job.identity]
        return max(alike, key=lambda cell: cell.finished, default=None)

    def find_all(self, jobs: Sequence[Job]) -> dict[Job, Cell]:
        """Return the cells of jobs that come after what they need.

        Where cells of several versions of the code may be used, one that others went
        on from is theirs, also where another comparison has made it again since.
        """
        found: dict[Job, Cell] = {}
        read: set[str] = set()
        for job in reversed(jobs):
            cell = self.find(job)
            theirs = [
                c for key in read if (c := self._by_key[key]).identity == job.identity
            ]
            if theirs:
                cell = max(theirs, key=lambda one: one.finished)
            if cell is not None:
                found[job] = cell
                named = (_NEEDED.findall(value) for value in cell.options.values())
                read |= {key for keys in named for key in keys if key in self._by_key}
        return found

    def elsewhere(self, job: Job) -> bool:
        """Return whether a job went on from another run than the cells show."""
        cell = self.find(job)
        if cell is None:
            return False
        return any(
            (of := self._by_key.get(key)) is not None and outcome(of.rows) != began
            for key, began in cell.began_from.items()
        )

    def others(self, jobs: Iterable[Job]) -> int:
        """Count the jobs that have cells of another version of the code alone."""
        known = {cell.identity for cell in self._by_key.values()}
        return sum(j.key not in self._by_key and j.identity in known for j in jobs)

    def add(self, job: Job, cell: Cell) -> Cell:
        """Write the cell of a job that has just finished; return the one that stands.

        Where it ran again for its folder alone, that is the first one.
        """
        if (first := self._by_key.get(job.key)) is not None:
            return first
        self._by_key[job.key] = cell
        cell.write(self.folder(job) / "cell.json")
        if self.cells is not None:
            self.cells.mkdir(parents=True, exist_ok=True)
            cell.write(self.cells / f"{job.folder}.json")
        return cell

    def folder(self, job: Job) -> Path:
        """Return where a job runs."""
        return self.jobs / job.folder

    def run_folder(self, job: Job) -> Path:
        """Return what a job writes; it is there once the job is finished."""
        return self.folder(job) / "run"

    def check(self) -> None:
        """Check that cells can be written, before hours are spent.

        Raises:
            RlcoError: They cannot.
        """
        for folder in (self.jobs, self.cells):
            if folder is None:
                continue
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise RlcoError(
                    f"folder {str(folder)!r} cannot be made ({error.strerror}); give "
                    "another one."
                ) from error
