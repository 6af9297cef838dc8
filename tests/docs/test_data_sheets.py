"""Each figure has a data sheet: how it was made, by which code, where, which seeds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pages import DOCS, write_results

from rlco.runs.compare.cells import Store
from rlco.runs.compare.jobs import expand
from rlco.runs.compare.reading.read_experiment import read_experiment

ROOT = DOCS.parent
KINDS = (".png", ".mp4", ".html")


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


FROM_CELLS = {row[2].strip("`") for row in sheets() if "/experiments/" in row[2]}


@pytest.mark.parametrize("path", sorted(FROM_CELLS))
def test_the_code_of_a_figure_of_cells_is_that_of_the_cells(
    path: str, tmp_path: Path
) -> None:
    name = Path(path).stem
    folder = ROOT / "benchmarks" / "cells" / write_results().CELLS.get(name, name)
    store = Store(tmp_path, folder, "any")
    cells = store.find_all(expand(read_experiment(ROOT / path))).values()
    commits = {cell.commit[:7] for cell in cells if cell.commit}
    for row in sheets():
        if row[2].strip("`") == path:
            assert set(re.findall(r"`([0-9a-f]{7})`", row[3])) == commits, row[0]
