"""Cells and attempts that are none are refused or not counted, whatever they hold."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import pytest

from rlco.errors import DataError
from rlco.runs.compare.cells import Cell, Store, read_cell
from rlco.runs.compare.jobs import file_hash
from rlco.runs.compare.queue import attempts_of

ROW = {"method": "sft", "domain": "sim", "episodes": 4, "successes": 3}


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A file of a cell."""
    path = tmp_path / "cells" / "sft.json"
    path.parent.mkdir()
    Cell(
        name="sft",
        key="k",
        identity="i",
        code="c",
        script="recipes/sft.py",
        options={"seed": "1"},
        rows=[ROW],
        curves={"metrics.csv": [{"step": 1.0, "success_sim": 0.5, "kl": math.nan}]},
        cpu_seconds=2.5,
        versions={"torch": "2"},
    ).write(path)
    return path


def test_a_pipe_that_an_option_names_is_no_file_to_hash(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert file_hash(str(tmp_path / "pipe")) is None
    (tmp_path / "file").write_bytes(b"abc")
    assert str(file_hash(str(tmp_path / "file"))).startswith("ba7816bf")


def test_a_cell_is_read_as_it_was_written(cell: Path) -> None:
    before = cell.read_bytes()
    read_cell(cell).write(cell)
    assert cell.read_bytes() == before


def test_a_cell_may_leave_out_what_has_a_default(cell: Path) -> None:
    content = json.loads(cell.read_text())
    few = ("name", "key", "identity", "code", "script", "options")
    cell.write_text(json.dumps({name: content[name] for name in few} | {"rows": []}))
    assert read_cell(cell).attempts == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("key", [1]),
        ("name", None),
        ("identity", {}),
        ("options", {"seed": 1}),
        ("options", []),
        ("rows", 5),
        ("rows", [5]),
        ("rows", [{**ROW, "successes": 5}]),
        ("curves", 7),
        ("curves", {"metrics.csv": 7}),
        ("curves", {"metrics.csv": [{"step": "x"}]}),
        ("cpu_seconds", "x"),
        ("attempts", []),
        ("commit", 5),
        ("versions", {"torch": 2}),
        ("finished", 3),
        ("began_from", {"k": 1}),
        ("more", 1),
    ],
)
def test_a_cell_with_another_type_is_refused(
    cell: Path, name: str, value: object
) -> None:
    cell.write_text(json.dumps(json.loads(cell.read_text()) | {name: value}))
    with pytest.raises(DataError, match="take it away"):
        Store(cell.parent / "out", cell.parent)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "5", "[" * 100_000, "\xff", "{}"),
        *('{"attempts": 5}', '{"attempts": [5]}', '{"attempts": [{"status": 1}]}'),
    ],
)
def test_attempts_that_are_none_do_not_count(tmp_path: Path, text: str) -> None:
    (tmp_path / "attempts.json").write_bytes(text.encode("latin-1"))
    assert attempts_of(tmp_path) == []
