"""Each figure has a data sheet: how it was made, by which code, where, which seeds."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import pytest
from pages import DOCS

from rlco.runs.compare.jobs import expand
from rlco.runs.compare.read_experiment import read_experiment

ROOT = DOCS.parent
KINDS = (".png", ".mp4", ".html")
CELLS = {"planar": "planar", "alignment": "push_cube"}


def sheets() -> Iterator[tuple[str, ...]]:
    """Yield the rows: figure, what it shows, how made, code, machine, seeds."""
    for line in (DOCS / "data_sheets.md").read_text("utf-8").splitlines():
        if line.startswith("| `"):
            yield tuple(cell.strip() for cell in line.strip("|").split(" | "))


def drawn() -> set[str]:
    """Return the names of all figures, films and reports."""
    folders = (DOCS / "figures", DOCS / "gallery")
    return {file.name for folder in folders for file in folder.iterdir()}


def test_every_figure_has_one_data_sheet_and_every_sheet_a_figure() -> None:
    named = [row[0].strip("`") for row in sheets()]
    assert sorted(named) == sorted(name for name in drawn() if name.endswith(KINDS))


def test_every_figure_of_the_pages_is_one_of_them() -> None:
    pages = [ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("tables/*.md")]
    pages += [ROOT / "benchmarks" / "README.md"]
    shown = {
        name
        for page in pages
        for name in re.findall(
            r"!\[[^\]]*\]\([^)]*?([\w.-]+)\)", page.read_text("utf-8")
        )
    }
    assert len(shown) > 15
    assert shown <= drawn()


@pytest.mark.parametrize("row", sheets(), ids=lambda row: row[0].strip("`"))
def test_a_data_sheet_is_filled_in(row: tuple[str, ...]) -> None:
    assert len(row) == 6
    _, shows, made, code, machine, seeds = row
    assert all((shows, made, machine, seeds))
    assert "unknown" not in " ".join(row)
    assert re.search(r"`[0-9a-f]{7}`", code)
    for path in re.findall(r"(?:benchmarks|recipes|scripts)/[\w/]+\.(?:py|yaml)", made):
        assert (ROOT / path).is_file(), path


@pytest.mark.parametrize("name", CELLS)
def test_the_code_of_a_figure_of_cells_is_that_of_the_cells(name: str) -> None:
    files = (ROOT / "benchmarks" / "cells" / CELLS[name]).glob("*.json")
    cells = [json.loads(file.read_text("utf-8")) for file in files]
    # Experiments with jobs in common share a folder.
    experiment = ROOT / "benchmarks" / "experiments" / f"{name}.yaml"
    jobs = {job.name for job in expand(read_experiment(experiment))}
    commits = {cell["commit"][:7] for cell in cells if cell["name"] in jobs}
    rows = [row for row in sheets() if f"experiments/{name}.yaml" in row[2]]
    assert rows
    assert {row[3].strip("`") for row in rows} == commits
