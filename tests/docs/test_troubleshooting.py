"""The messages on the troubleshooting page are those that the library raises."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from pages import DOCS

ROOT = DOCS.parent


@cache
def texts() -> tuple[str, ...]:
    """Return every string in the library and the recipes, with … for what varies."""
    found = []
    for path in [*ROOT.glob("rlco/**/*.py"), *ROOT.glob("recipes/*.py")]:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
            if isinstance(node, ast.JoinedStr):
                found.append("".join(map(_part, node.values)))
    return tuple(found)


def _part(node: ast.expr) -> str:
    return str(node.value) if isinstance(node, ast.Constant) else "…"


def quoted() -> list[str]:
    """Return the messages that the page's tables quote."""
    page = (Path(DOCS) / "troubleshooting.md").read_text("utf-8")
    cells = re.findall(r"^\| (.*?) \|", page, re.MULTILINE)
    return [m for cell in cells if "verdict" not in cell for m in _code(cell)]


def _code(cell: str) -> list[str]:
    return re.findall(r"`(.+?)`", cell)


@pytest.mark.slow
@pytest.mark.parametrize("message", quoted())
def test_a_quoted_message_is_one_that_is_raised(message: str) -> None:
    assert any(message in text for text in texts())
