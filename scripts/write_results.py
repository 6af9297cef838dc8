"""Write the tables and figures of the experiments from their committed cells.

    uv run scripts/write_results.py

Each experiment of benchmarks/experiments whose cells are all there gets a page of all
its tables, docs/tables/NAME.md, and figures, docs/figures/NAME-*.png. In README.md and
the pages of docs, what stands between the lines `<!-- results NAME -->` and
`<!-- end -->` becomes the first table of NAME: of several groups the overview, their
mean, and what was predicted. After `<!-- results NAME: COLUMN, COLUMN -->` it has these
columns alone, after `<!-- results NAME, DOMAIN -->` the rows in this domain, after
`<!-- results NAME, mean -->` the means over groups, and after
`<!-- results NAME, cost -->` what its jobs took.
"""

from __future__ import annotations

import functools
import importlib.util
import re
import shutil
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from rlco.runs.compare.cells import Store
from rlco.runs.compare.jobs import expand
from rlco.runs.compare.reading.read_experiment import read_experiment

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BENCHMARKS = ROOT / "benchmarks"
#: Where the cells of an experiment are, if not in a folder of its name.
ON_PUSH_CUBE = ("alignment", "two_by_two", "length", "methods", "adapted", "kinds")
CELLS = dict.fromkeys(ON_PUSH_CUBE, "push_cube")
ON_IMAGES = (
    "encoders",
    "encoders_further",
    "paper_images",
    "generalisation_images",
)
CELLS |= dict.fromkeys(ON_IMAGES, "sight")
ON_POSES = ("generalisation", "take_off", "data", "alpha", "paper_kinds")
CELLS |= dict.fromkeys(ON_POSES, "paper")
MARKED = re.compile(
    r"(<!-- results (\w+)(?:, (\w+))?(?:: ([^>]+))? -->\n).*?(<!-- end -->)",
    re.DOTALL,
)


def main() -> None:
    """Write what there are cells for."""
    first: dict[str, str] = {}
    for path in sorted((BENCHMARKS / "experiments").glob("*.yaml")):
        cells = BENCHMARKS / "cells" / CELLS.get(path.stem, path.stem)
        missing, every = count_missing(path, cells)
        if missing:
            print(f"{path.stem}: {missing} of {every} cells are not in yet")
        else:
            first |= write_page(path.stem, path, cells)
    for page in (ROOT / "README.md", *sorted(DOCS.glob("*.md"))):
        text = page.read_text("utf-8")
        written = filled(text, first)
        if written != text:
            page.write_text(written, "utf-8")
            print(f"{page.relative_to(ROOT)}: written")


def count_missing(experiment: Path, cells: Path) -> tuple[int, int]:
    """Return how many results of an experiment have no cell, and how many it has."""
    with tempfile.TemporaryDirectory() as out:
        store = Store(Path(out), cells, "any")
    jobs = [job for job in expand(read_experiment(experiment)) if job.kind.results]
    return sum(store.find(job) is None for job in jobs), len(jobs)


@functools.cache
def recipe(name: str) -> ModuleType:
    """Return the module of a recipe, which is in no package."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "recipes" / f"{name}.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(f"recipes/{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # its options' types are looked up there
    spec.loader.exec_module(module)
    return module


def write_page(name: str, experiment: Path, cells: Path) -> dict[str, str]:
    """Write an experiment's page and figures, and return what pages may show of it."""
    with tempfile.TemporaryDirectory() as out:
        # In this process: to start one for each takes longer than the tables.
        config = {"experiment": str(experiment), "cells": str(cells), "out": out}
        compare = recipe("compare")
        compare.main(compare.Config(**config, hours=0, code="any"))
        tables = (Path(out) / "table.md").read_text("utf-8")
        figures: list[str] = []
        for figure in sorted(Path(out, "plots").glob("*.png")):
            figures = figures or ["\n## Figures\n"]
            kept = f"{name}-{figure.stem.replace(' ', '-')}.png"
            shutil.copy(figure, DOCS / "figures" / kept)
            figures.append(f"![{figure.stem}](../figures/{kept})\n")
    run = f"uv run recipes/compare.py experiment={experiment.relative_to(ROOT)}"
    again = f"{run} cells={cells.relative_to(ROOT)} hours=0 code=any"
    page = DOCS / "tables" / f"{name}.md"
    page.parent.mkdir(exist_ok=True)
    text = (
        f"# {name}\n\nEvery job anew, and this page from its committed cells:\n\n"
        f"```\n$ {run}\n$ {again}\n```\n\n{tables}"
    )
    page.write_text(text + "\n".join(figures), "utf-8")
    print(f"docs/tables/{name}.md: written")
    overview, *sections = tables.split("\n## ")
    overview = re.sub(r"\A## .*\n+", "", overview)  # of the only group
    parts = {
        head: part.strip() for head, part in (one.split("\n", 1) for one in sections)
    }
    over_all = [
        parts[head] for head in ("Mean", "Predictions", "Drift") if head in parts
    ]
    first = "\n\n".join((overview.strip(), *over_all))
    alone = {head.lower(): parts[head] for head in ("Mean", "Cost") if head in parts}
    return {name: first} | {f"{name}, {head}": part for head, part in alone.items()}


def filled(text: str, tables: Mapping[str, str]) -> str:
    """Return a page with its marked tables; as they were, where there is none."""

    def part(found: re.Match[str]) -> str:
        begin, name, which, columns, end = found.groups()
        if name not in tables:
            return found[0]
        table = tables.get(f"{name}, {which}") if which else tables[name]
        if table is None:
            table = rows_of(tables[name], which)
        if columns:
            table = narrowed(table, [column.strip() for column in columns.split(",")])
        return f"{begin}{table}\n{end}"

    return MARKED.sub(part, text)


def rows_of(tables: str, which: str) -> str:
    """Return the rows in a domain with what others published of them."""
    parts = tables.split("\n\n")
    if f", {which} |" not in parts[0]:
        raise ValueError(f"{which!r} is no domain of the rows of the first table")
    kept = []
    for part in parts:
        head, rows = part.splitlines()[:2], part.splitlines()[2:]
        mine = [row for row in rows if row.startswith("| *") or f", {which} |" in row]
        kept.append("\n".join([*head, *mine]) if head[0].startswith("| ") else part)
    return "\n\n".join(kept)


def narrowed(tables: str, columns: list[str]) -> str:
    """Return the first column of the first table and some others, without its marks."""
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in tables.split("\n\n")[0].splitlines()
    ]
    kept = [0, *(lines[0].index(column) for column in columns)]
    rows = [[line[place].removesuffix(" \\*") for place in kept] for line in lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    main()
