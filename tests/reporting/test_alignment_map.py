"""What the maps say of a case, and that their file is that of the committed cells."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

from rlco.reporting.alignment.map import (
    METHODS,
    Column,
    as_json,
    in_words,
    neighbours,
    read_map,
)
from rlco.reporting.alignment.page import map_table

ROOT = Path(__file__).parents[2]


def script() -> ModuleType:
    """Return scripts/write_alignment_map.py, which is in no package."""
    path = ROOT / "scripts" / "write_alignment_map.py"
    spec = importlib.util.spec_from_file_location("write_alignment_map", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_the_map_is_what_the_cells_say() -> None:
    module = script()
    written = [column for task in module.MAPS for column in module.columns(task)]
    assert as_json(written) == json.loads(module.MAP.read_text("utf-8"))


def test_each_column_has_as_many_seeds_of_all_it_compares() -> None:
    columns = read_map()
    assert len(columns) == 11  # eight planar gaps, three yaws of push_cube
    assert [c.share for c in columns] == sorted(c.share for c in columns)
    for column in columns:
        assert {len(column.success[m]) for m in METHODS} == {len(column.cross)} == {5}


def column(gap: str, share: float, **success: float) -> Column:
    rates = dict.fromkeys(METHODS, 0.5) | success
    return Column("planar", gap, [share] * 2, {m: [r, r] for m, r in rates.items()})


def test_a_share_between_two_columns_has_both_as_neighbours() -> None:
    columns = [column(name, share) for name, share in (("a", -1), ("b", 0), ("c", 1))]
    near = {share: neighbours(columns, share) for share in (-2.0, 0.0, 0.4, 3.0)}
    assert {s: [c.gap for c in found] for s, found in near.items()} == {
        -2.0: ["a"],
        0.0: ["b", "c"],
        0.4: ["b", "c"],
        3.0: ["c"],
    }


def test_differences_are_within_seeds() -> None:
    success = {m: [0.2, 0.6] for m in METHODS} | {"rl_only": [0.1, 0.5]}
    found = Column("planar", "turned", [0.0, 0.0], success)
    lost = found.gain("rl_only", "sft")
    # Each seed loses ten points: seeds that differ do not blur it.
    assert lost == pytest.approx((-0.1, -0.1, -0.1))
    assert "ended -10.0 [-10.0, -10.0] points from there" in in_words(found)


def test_ones_own_case_stands_where_it_belongs_in_the_table() -> None:
    html = map_table([column("first", -1.0), column("second", 1.0)], 0.25)
    assert html.index("first") < html.index("your case") < html.index("second")
