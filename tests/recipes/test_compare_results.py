"""The recipe that compares two evaluations prints a table, and writes its numbers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from recipe_cases import refused, start


def _evaluation(folder: Path, method: str, outcomes: list[int]) -> Path:
    folder.mkdir()
    row = {
        "method": method,
        "task": "push_cube",
        "policy": "gaussian",
        "domain": "sim",
        "variation": None,
        "seed": 0,
        "episodes": len(outcomes),
        "successes": sum(outcomes),
        "outcomes": outcomes,
    }
    (folder / "results.json").write_text(json.dumps({"rows": [row]}))
    return folder


def test_two_evaluations_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a = _evaluation(tmp_path / "a", "rl_co", [1] * 8)
    b = _evaluation(tmp_path / "b", "sft", [0] * 8)
    out = tmp_path / "new" / "compared"
    start("compare_results", f"a={a}", f"b={b}", f"out={out}")
    shown = capsys.readouterr()
    assert "| push_cube, sim | 100.0% | 0.0% | +100.0 [" in shown.out
    assert "| 8 | 0 | 0.0078 | 8 | 1 |" in shown.out
    assert "for these two policies, not for two methods" in shown.err
    assert (out / "table.md").read_text() == shown.out
    (row,) = json.loads((out / "comparison.json").read_text())["rows"]
    assert row["p_value"] == pytest.approx(2 / 2**8)
    assert row["difference"][0] == 1.0
    words = refused(capsys, "compare_results", f"a={a}", f"b={b}", f"out={out}")
    assert "compared" in words
    assert "exists" in words
    below = f"out={a / 'results.json' / 'under'}"
    words = refused(capsys, "compare_results", f"a={a}", f"b={b}", below)
    assert "cannot be made (Not a directory)" in words
    words = refused(capsys, "compare_results", f"a={a}", f"b={b}", "out=/proc/x")
    assert "cannot be made (No such file or directory)" in words  # root has rights


def test_the_same_name_is_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a = _evaluation(tmp_path / "a", "sft", [1, 0])
    b = _evaluation(tmp_path / "b", "sft", [1, 1])
    start("compare_results", f"a={a}", f"b={b}")
    assert "| environment | sft (a) | sft (b) |" in capsys.readouterr().out


def test_what_only_one_has_is_said_and_names_move_no_cursor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a = _evaluation(tmp_path / "a", "\x1b[2Jsft", [1, 0])
    rows = json.loads((a / "results.json").read_text())["rows"]
    rows.append({**rows[0], "domain": "stand_in"})
    (a / "results.json").write_text(json.dumps({"rows": rows}))
    b = _evaluation(tmp_path / "b", "rl_co", [1, 1])
    start("compare_results", f"a={a}", f"b={b}")
    shown = capsys.readouterr()
    assert f"what only {a / 'results.json'} has is left out: push_cube, " in shown.err
    assert "stand_in" in shown.err
    assert "| \\x1b[2Jsft |" in shown.out
    assert "\x1b" not in shown.out


def test_what_is_no_evaluation_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a = _evaluation(tmp_path / "a", "sft", [1, 0])
    words = refused(capsys, "compare_results", f"a={a}", f"b={tmp_path}")
    assert "holds neither results.json nor eval_info.json" in words
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "results.json").write_text('{"rows": []}')
    words = refused(capsys, "compare_results", f"a={a}", f"b={tmp_path / 'none'}")
    assert "results.json has no rows; evaluate a policy first" in words
    row = json.loads((a / "results.json").read_text())["rows"][0]
    del row["seed"]
    (tmp_path / "none" / "results.json").write_text(json.dumps({"rows": [row]}))
    words = refused(capsys, "compare_results", f"a={a}", f"b={tmp_path / 'none'}")
    assert "entry 1 of 'rows' of file" in words
    assert "lacks 'seed'" in words
    words = refused(capsys, "compare_results", f"a={a}", f"b={'x' * 300}")
    assert "is none that the system can follow (File name too long)" in words
    words = refused(capsys, "compare_results", f"a={a}", f"b={a}", "method_b=rl_co")
    assert "has no method 'rl_co'; give method_b= one of sft" in words
