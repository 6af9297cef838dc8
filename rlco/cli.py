"""The command `rlco`: runs, lists and copies the recipes of an installed rlco.

    rlco list                     recipes, a line each
    rlco NAME key=value ...       run a recipe; `rlco NAME help` lists its options
    rlco copy NAME                copy a recipe into this folder, to edit it
    rlco info                     versions, devices, rendering, and what is missing

A recipe is found by its path and never imported by the library: it lies in
``rlco/_recipes`` of a wheel, and in ``recipes`` of a checkout.
"""

from __future__ import annotations

import ast
import importlib.util
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import rlco
from rlco.errors import RlcoError, suggest

_COMMANDS = ("list", "copy", "info")
_HELP = ("help", "--help", "-h")


def main(argv: Sequence[str] | None = None) -> None:
    """Run a command; wrong use ends with one sentence and status 2."""
    name, *given = (sys.argv[1:] if argv is None else argv) or ["help"]
    try:
        if name in _HELP:
            _say(__doc__ or "")
        elif name == "--version":
            _say(rlco.__version__)
        elif name in _COMMANDS:
            {"list": _list, "copy": _copy, "info": _info}[name](given)
        else:
            run(name, given)
    except RlcoError as error:
        sys.stderr.write(f"error: {error}\n")
        raise SystemExit(2) from None


def recipes() -> dict[str, Path]:
    """Return the recipes' files by name.

    Example:
        >>> "quickstart" in recipes()
        True
    """
    package = Path(rlco.__file__).parent
    for folder in (package / "_recipes", package.parent / "recipes"):
        if folder.is_dir():
            return {path.stem: path for path in sorted(folder.glob("*.py"))}
    raise RlcoError(
        f"{str(package)!r} holds no recipes; install rlco from a wheel, or run it in a "
        "checkout."
    )


def run(name: str, argv: Sequence[str]) -> None:
    """Run a recipe with the arguments after its name.

    Raises:
        RlcoError: There is no such recipe.
    """
    from rlco.run import run_recipe

    module = _load(_found(name))
    run_recipe(module.main, module.Config, argv)


def _found(name: str) -> Path:
    known = recipes()
    if name not in known:
        near = suggest(name, [*known, *_COMMANDS])
        raise RlcoError(
            f"there is no recipe or command {name!r}{near}; recipes are "
            f"{', '.join(known)}, commands {', '.join(_COMMANDS)}."
        )
    return known[name]


def _load(path: Path) -> ModuleType:
    name = f"rlco_recipe_{path.stem}"  # no recipe hides a module of another's
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their types up there
    spec.loader.exec_module(module)
    return module


def _list(given: Sequence[str]) -> None:
    _refuse(given, "list")
    known = recipes()
    width = max(map(len, known))
    for name, path in known.items():
        said = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
        _say(f"{name:{width}}  {said.splitlines()[0]}")


def _copy(given: Sequence[str]) -> None:
    if len(given) != 1:
        raise RlcoError(
            f"rlco copy takes the name of one recipe, not {len(given)} arguments; "
            "`rlco list` shows the names."
        )
    path = _found(given[0])
    sources = [one for one in (path, path.with_suffix("")) if one.exists()]
    there = [one.name for one in sources if Path(one.name).exists()]
    if there:
        raise RlcoError(
            f"{there[0]!r} exists in this folder and is not overwritten; rename it, or "
            "copy the recipe in another folder."
        )
    for source in sources:
        if source.is_dir():
            shutil.copytree(source, source.name)
        else:
            shutil.copy(source, source.name)
    _say(f"copied to {path.name}; edit it and run it: python {path.name} help")


def _info(given: Sequence[str]) -> None:
    from rlco.installation import report

    _refuse(given, "info")
    missing = False
    for line in report():  # line by line, since to import torch takes seconds
        missing |= line.startswith("missing")
        _say(line)
    raise SystemExit(1 if missing else 0)


def _refuse(given: Sequence[str], command: str) -> None:
    if given:
        raise RlcoError(f"rlco {command} takes no arguments, not {given[0]!r}.")


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
