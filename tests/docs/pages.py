"""Read the documentation's pages, and the script that writes their tables."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Any

DOCS = Path(__file__).parents[2] / "docs"


def run_python(page: str, heading: str = "") -> dict[str, Any]:
    """Run a page's Python, from a heading on up to the next; return its variables.

    Args:
        page: Its name, ``native.md``.
        heading: ``## Worlds that differ``; the whole page where empty.
    """
    text = (DOCS / page).read_text()
    if heading:
        text = text.split(f"\n{heading}\n", 1)[1].split("\n## ", 1)[0]
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert blocks, f"{page} has no Python under {heading!r}"
    variables: dict[str, Any] = {}
    exec("\n".join(blocks), variables)
    return variables


def write_results() -> ModuleType:
    """Return scripts/write_results.py, which is in no package."""
    path = DOCS.parent / "scripts" / "write_results.py"
    spec = importlib.util.spec_from_file_location("write_results", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
