"""What may be imported without torch, and what a recipe may import."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

#: Read where torch may be missing or slow: help, wrong input, logs, models.
WITHOUT_TORCH = (
    "rlco.keys",
    "rlco.errors",
    "rlco.runs.config",
    "rlco.training.options.policy_options",
    "rlco.training.stage_one",
    "rlco.training.stage_two",
    "rlco.run",
    "rlco.reporting.statistics",
    "rlco.reporting.plots",
    "rlco.reporting.image_plots",
    "rlco.reporting.report",
    "rlco.lerobot_files",
    "rlco.physics",
    *(["rlco.gap"] if importlib.util.find_spec("rlco.gap") else []),
)


@pytest.mark.slow
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


# -- Recipes -----------------------------------------------------------------------

RECIPES = Path(__file__).parents[1] / "recipes"


def imported(source: str) -> set[str]:
    """Return the first names of all modules that a source file imports."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            # A relative import is of a sibling, whatever it names.
            found.add((node.module or "").partition(".")[0] if not node.level else ".")
    return found


@pytest.mark.parametrize(
    "recipe", sorted(RECIPES.glob("*.py")), ids=lambda path: path.stem
)
def test_a_recipe_imports_no_other_file_of_its_folder(recipe: Path) -> None:
    siblings = {path.stem for path in RECIPES.glob("*.py")} | {"recipes", "."}
    assert not imported(recipe.read_text("utf-8")) & siblings


def test_every_file_of_the_recipes_is_one_that_can_be_started() -> None:
    helpers = [
        path.name
        for path in RECIPES.glob("*.py")
        if "run_recipe(main," not in path.read_text("utf-8")
    ]
    assert helpers == []
