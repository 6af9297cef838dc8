"""Each fault of docs/faults.md names the test that shows it, and that test exists."""

from __future__ import annotations

import ast
import re

import pytest
from pages import DOCS

ROOT = DOCS.parent


def rows() -> list[list[str]]:
    """Return the cells of every fault."""
    lines = (DOCS / "faults.md").read_text("utf-8").splitlines()
    cells = [line.strip("| ").split(" | ") for line in lines if line.startswith("| ")]
    return [row for row in cells if row[0] != "fault"]


def test_there_are_faults_of_all_kinds() -> None:
    faults = [row[0] for row in rows()]
    assert len(faults) == len(set(faults)) >= 20


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_a_fault_is_shown_by_a_test_that_exists(row: list[str]) -> None:
    _, happens, left, test = row
    assert happens.strip()
    assert left.strip()
    named = re.fullmatch(r"`(tests/[\w/]+\.py)(?:::(test_\w+))?`", test)
    assert named is not None, test
    path = ROOT / named[1]
    tests = [
        node.name
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    assert (named[2] in tests) if named[2] else tests
