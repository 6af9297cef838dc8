"""The experiments' tables in the pages are those of the committed cells."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure
from pages import DOCS, write_results

pytestmark = pytest.mark.slow
ROOT = DOCS.parent


def test_marked_tables_are_what_the_cells_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = write_results()
    (tmp_path / "figures").mkdir()
    monkeypatch.setattr(module, "DOCS", tmp_path)
    # Other tests draw; here it would take as long as all the rest.
    monkeypatch.setattr(Figure, "savefig", lambda _, path, **options: path.touch())
    texts = {
        page.name: page.read_text("utf-8")
        for page in (ROOT / "README.md", *sorted(DOCS.glob("*.md")))
    }
    marked = {
        name for text in texts.values() for _, name, *_ in module.MARKED.findall(text)
    }
    assert "planar" in marked
    tables: dict[str, str] = {}
    for name in marked:
        tables |= module.write_page(
            name,
            module.BENCHMARKS / "experiments" / f"{name}.yaml",
            module.BENCHMARKS / "cells" / module.CELLS.get(name, name),
        )
    for page, text in texts.items():
        assert module.filled(text, tables) == text, page
    # Figures of the page lie where it looks for them.
    assert (tmp_path / "figures" / "planar-prediction-1.png").is_file()


def test_of_many_rows_those_of_a_domain_the_means_or_the_cost_may_be_shown() -> None:
    head = "| success in | sft |\n|---|---|"
    published = "| *a robot* | *9%* |"
    every = f"{head}\n| task x, sim | 5% |\n| task x, real | 6% |\n{published}"
    mean = "| mean over task, in | sft |\n|---|---|\n| kind k, real | 7% |"
    note = "A note\nof three\nlines."
    cost = "| minutes of a processor, a job | sft |"
    tables = {"m": f"{every}\n\n{mean}\n\n{note}", "m, mean": mean, "m, cost": cost}

    def shown(which: str) -> str:
        page = f"<!-- results m, {which} -->\nold\n<!-- end -->"
        found = write_results().filled(page, tables)
        return found.removeprefix(f"<!-- results m, {which} -->\n")

    rows = f"{head}\n| task x, real | 6% |\n{published}"
    assert shown("real") == f"{rows}\n\n{mean}\n\n{note}\n<!-- end -->"
    assert shown("mean") == f"{mean}\n<!-- end -->"
    assert shown("cost") == f"{cost}\n<!-- end -->"
    with pytest.raises(ValueError, match="'moon' is no domain"):
        shown("moon")


def test_a_table_may_be_narrowed_to_some_columns() -> None:
    table = "| method | sim | worst | real |\n|---|---|---|---|\n"
    table += "| sft \\* | 5% | 3% | 7% |"
    begin, end = "a\n<!-- results m: real, sim -->\n", "\n<!-- end -->\nb"
    narrow = "| method | real | sim |\n| --- | --- | --- |\n| sft | 7% | 5% |"
    tables = {"m": f"{table}\n\n| more |"}
    assert write_results().filled(f"{begin}old{end}", tables) == f"{begin}{narrow}{end}"
