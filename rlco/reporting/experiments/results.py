"""What an experiment came to: the rows of its cells, and the entries of its table."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from rlco.errors import DataError
from rlco.reporting.experiments.entries import Entry, State, group_name
from rlco.runs.compare.cells import Cell, Store
from rlco.runs.compare.experiment import Experiment, Line, Table
from rlco.runs.compare.jobs import Job
from rlco.runs.compare.queue import failed_before
from rlco.runs.compare.templates import filled


def result_rows(jobs: Sequence[Job], store: Store) -> list[dict[str, Any]]:
    """Return every row of every cell, with its job, values of variables and key."""
    rows = []
    for job in jobs:
        if (cell := store.find(job)) is not None:
            about = {"job": job.kind.name, "over": dict(job.values), "key": cell.key}
            rows += [{**row, **about} for row in cell.rows]
    return rows


def table_entries(
    experiment: Experiment, jobs: Sequence[Job], store: Store
) -> list[Entry]:
    """Return what each method came to, in every group and with every seed.

    What is missing, or failed, is an entry as well.

    Raises:
        DataError: A cell has no row of the method that a line asks for.
    """
    failed = failed_before(jobs, store)
    table = experiment.table
    found = []
    for group, values in _groups(experiment):
        for number, line in enumerate(table.lines):
            for job in jobs:
                # What a line is always of counts for more than what its table is of.
                if job.kind.name != line.job or not _agree(job, {**values, **line.at}):
                    continue
                cell = store.find(job)
                state: State = "failed" if job in failed else "missing"
                rows: tuple[dict[str, Any], ...] = ()
                if cell is not None:
                    state = "done" if cell.key == job.key else "older"
                    rows = _shown(_rows(cell, line), table)
                label = filled(line.label, job.values)
                seed = job.values.get(table.seed)
                curve = cell.curves.get(line.curve, ()) if cell and line.curve else ()
                minutes = cell.cpu_seconds / 60 if cell else None
                found.append(
                    Entry(
                        label,
                        group,
                        seed,
                        state,
                        rows,
                        tuple(curve),
                        minutes,
                        values,
                        line.at,
                        number,
                    )
                )
    return found


def _groups(experiment: Experiment) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what there is a table of: its name, and the values of its variables."""
    by = experiment.table.by
    for combination in itertools.product(*(experiment.over[name] for name in by)):
        values = dict(zip(by, combination, strict=True))
        yield group_name(values), values


def _rows(cell: Cell, line: Line) -> tuple[dict[str, Any], ...]:
    """Return the rows of a cell that a line of the table is of."""
    rows = tuple(row for row in cell.rows if line.method in (None, row["method"]))
    if not rows:
        methods = ", ".join(dict.fromkeys(str(row["method"]) for row in cell.rows))
        raise DataError(
            f"{cell.name} has no result of method {line.method!r}, which the table "
            f"asks for; it has {methods}."
        )
    return rows


def _shown(
    rows: tuple[dict[str, Any], ...], table: Table
) -> tuple[dict[str, Any], ...]:
    """Return the rows of a table's domains.

    Where its groups are of variations, a row of one stands beside rows of none.
    """
    known = "variation" in table.by
    return tuple(
        {**row, "variation": None} if known else row
        for row in rows
        if not table.domains or row["domain"] in table.domains
    )


def made_by(jobs: Sequence[Job], store: Store) -> str:
    """Return how long all jobs took, and which code and processors they ran on.

    In Markdown; "" where none has finished.
    """
    cells = list(store.find_all(jobs).values())
    if not cells:
        return ""
    hours = sum(cell.cpu_seconds for cell in cells) / 3600
    commits, processors = (
        ", ".join(f"{name} ({count})" for name, count in Counter(found).most_common())
        for found in (
            [f"`{cell.commit[:7]}`" if cell.commit else "no commit" for cell in cells],
            [cell.processor or "not known" for cell in cells],
        )
    )
    elsewhere = [job.name for job in jobs if store.elsewhere(job)]
    return (
        f"\n{len(cells)} of {len(jobs)} jobs, recordings among them: {hours:.1f} hours "
        f"of a processor. Commits (jobs): {commits}. Processors: {processors}.\n"
        + _begun_elsewhere(elsewhere)
    )


def _begun_elsewhere(names: Sequence[str]) -> str:
    if not names:
        return ""
    return (
        f"\nBegun from another run of the job before them than the tables show, which "
        f"came to something else ({len(names)}): {', '.join(names)}.\n"
    )


def _agree(job: Job, values: dict[str, Any]) -> bool:
    """Return whether a job has these values, as far as it varies with them."""
    return all(job.values.get(name, value) == value for name, value in values.items())
