"""What may be imported without torch, seen from a fresh interpreter."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import pytest

#: Read where torch may be missing or slow: help, wrong input, logs, models.
WITHOUT_TORCH = (
    "rlco.keys",
    "rlco.errors",
    "rlco.config",
    "rlco.run",
    "rlco.statistics",
    "rlco.plots",
    "rlco.report",
    "rlco.lerobot_files",
    "rlco.physics",
    *(["rlco.gap"] if importlib.util.find_spec("rlco.gap") else []),
)


@pytest.mark.parametrize("module", WITHOUT_TORCH)
def test_module_is_imported_without_torch(module: str) -> None:
    # All of a package, not only what its __init__ names.
    code = (
        "import importlib, pkgutil, sys\n"
        f"found = importlib.import_module({module!r})\n"
        "for part in pkgutil.walk_packages(\n"
        "    getattr(found, '__path__', []), found.__name__ + '.'\n"
        "):\n"
        "    importlib.import_module(part.name)\n"
        "print(sorted({'torch', 'tensordict', 'torchrl'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"
