# /// script
# requires-python = ">=3.12"
# ///
"""Renew the exact versions in pyproject.toml: ``uv run scripts/renew_constraints.py``.

Resolves the newest versions that the dependencies allow, without the old pins, and
writes every one of them as ``name==version`` into ``[tool.uv]``. Only names and
versions go in, no address, so any package index will do. Where uv finds no
resolution, pyproject.toml stays as it was.
"""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT, LOCK = ROOT / "pyproject.toml", ROOT / "uv.lock"
UV = os.environ.get("UV", "uv")  # `uv run` says which uv it is
#: The whole table, to the next one or the end of the file.
TABLE = re.compile(r"^\[tool\.uv\]\n.*?(?=^\[|\Z)", re.MULTILINE | re.DOTALL)


def pins(lock: dict[str, Any]) -> list[str]:
    """List every resolved package but this project, each with its exact version."""
    found = {
        # The part behind "+" names a build of one index.
        (package["name"], package["version"].partition("+")[0])
        for package in lock["package"]
        if not {"editable", "virtual"} & set(package["source"])
    }
    names = [name for name, _ in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise SystemExit(
            f"error: {', '.join(twice)} resolved to several versions (one a platform); "
            "narrow the range in [project] dependencies so that one remains."
        )
    return [f"{name}=={version}" for name, version in sorted(found)]


def with_pins(text: str, new: list[str]) -> str:
    """Return pyproject.toml's text with these pins in place of the old ones."""
    rest = TABLE.sub("", text).rstrip() + "\n"
    if not new:
        return rest
    lines = "".join(f'    "{pin}",\n' for pin in new)
    return f"{rest}\n[tool.uv]\nconstraint-dependencies = [\n{lines}]\n"


def main() -> None:
    before = PYPROJECT.read_text("utf-8")
    old = tomllib.loads(before).get("tool", {}).get("uv", {})
    old_pins = old.get("constraint-dependencies", [])
    PYPROJECT.write_text(with_pins(before, []), "utf-8")
    try:
        subprocess.run([UV, "lock", "--upgrade"], cwd=ROOT, check=True)
        new_pins = pins(tomllib.loads(LOCK.read_text("utf-8")))
        PYPROJECT.write_text(with_pins(before, new_pins), "utf-8")
        # The pins must resolve by themselves.
        subprocess.run([UV, "lock"], cwd=ROOT, check=True)
    except (subprocess.CalledProcessError, SystemExit):
        PYPROJECT.write_text(before, "utf-8")
        raise
    for pin in sorted(set(old_pins) ^ set(new_pins)):
        print("+" if pin in new_pins else "-", pin)
    print(f"{len(new_pins)} versions pinned in {PYPROJECT.name}")


if __name__ == "__main__":
    main()
