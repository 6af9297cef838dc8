"""A results.json holds counts of successes, or is refused in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rlco.errors import DataError, RlcoError
from rlco.reporting.report import write_report
from rlco.run import Run
from rlco.runs.config import RunOptions
from rlco.runs.results_file import read_results

ROW = {"method": "sft", "domain": "sim", "seed": 0, "episodes": 4, "successes": 3}


def written(tmp_path: Path, content: object) -> Path:
    (tmp_path / "results.json").write_text(json.dumps(content))
    return tmp_path / "results.json"


def test_rows_come_back_as_they_are(tmp_path: Path) -> None:
    row = {**ROW, "task": None, "outcomes": [1, 1, 0, 1], "more": {"x": 1}}
    assert read_results(written(tmp_path, {"rows": [row]})) == [row]


@pytest.mark.parametrize(
    "change",
    [
        {"method": 3},
        {"domain": None},
        {"successes": 5},
        {"successes": -1},
        {"successes": "3"},
        {"episodes": 0},
        {"episodes": 1e400},
        {"seed": "0"},
        {"outcomes": [1]},
        {"outcomes": [1, 1, 0, 2]},
        {"outcomes": 3},
        {"successes": 2, "outcomes": [1, 1, 0, 1]},
        {"task": []},
    ],
)
def test_a_row_that_is_none(tmp_path: Path, change: dict[str, Any]) -> None:
    name = next(iter(change))
    with pytest.raises(DataError, match=f"'{name}' of entry 2 of 'rows' of file"):
        read_results(written(tmp_path, {"rows": [ROW, {**ROW, **change}]}))


@pytest.mark.parametrize("content", [[], {}, {"rows": 3}, {"rows": [3]}])
def test_a_file_that_is_none(tmp_path: Path, content: object) -> None:
    with pytest.raises(DataError, match=r"results\.json"):
        read_results(written(tmp_path, content))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("run.json", "{}"),
        ("run.json", '{"recipe": "x", "seconds": "y"}'),
        ("results.json", '{"rows": [{}]}'),
        ("results.json", json.dumps({"rows": [ROW]})),  # of no policy and no task
        ("metrics.csv", "step,loss\n1,x\n"),
        ("config.yaml", "\xff"),
    ],
)
def test_a_report_of_damaged_files(tmp_path: Path, name: str, text: str) -> None:
    with Run(RunOptions(out=str(tmp_path / "run")), "demo") as run:
        run.log_metrics(1, {"loss": 1.0})
        run.save_results([])
    write_report(tmp_path / "run")
    (tmp_path / "run" / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(RlcoError, match=name):
        write_report(tmp_path / "run")
