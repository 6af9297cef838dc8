"""Two evaluations of the same initial states: exact test, intervals, foreign files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from rlco.errors import DataError, RlcoError
from rlco.reporting.paired_results import (
    compare,
    exact_paired_test,
    notes,
    read_evaluation,
    table,
)
from rlco.reporting.statistics import ResultRow, paired_over_seeds

CELLS = Path(__file__).parents[2] / "benchmarks" / "cells" / "push_cube"


def _row(method: str, seed: int, outcomes: list[int], **other: Any) -> ResultRow:
    row = {
        "method": method,
        "task": "push_cube",
        "policy": "gaussian",
        "domain": "sim",
        "variation": None,
        "seed": seed,
        "episodes": len(outcomes),
        "successes": sum(outcomes),
        "outcomes": outcomes,
    }
    return cast(ResultRow, row | other)


def _written(folder: Path, *rows: ResultRow) -> Path:
    folder.mkdir()
    (folder / "results.json").write_text(json.dumps({"seconds": 1, "rows": rows}))
    return folder


def _lerobot(folder: Path, *tasks: list[bool]) -> Path:
    """An eval_info.json with the fields of lerobot-eval 0.6, several tasks."""
    folder.mkdir()
    per_task = [
        {"task_group": "libero", "task_id": i, "metrics": {"successes": won}}
        for i, won in enumerate(tasks)
    ]
    (folder / "eval_info.json").write_text(json.dumps({"per_task": per_task}))
    return folder


def test_the_exact_test_is_that_of_a_fair_coin() -> None:
    # 5 against 1: twice (C(6, 0) + C(6, 1)) / 2^6 = 14 / 64.
    assert exact_paired_test(5, 1) == pytest.approx(14 / 64)
    assert exact_paired_test(3, 3) == 1.0


@settings(deadline=None)  # the first takes scipy's import
@given(some.integers(0, 60), some.integers(0, 60))
def test_the_exact_test_does_not_depend_on_the_order(first: int, second: int) -> None:
    assert exact_paired_test(first, second) == pytest.approx(
        exact_paired_test(second, first)
    )


def test_one_seed_is_compared_over_its_initial_states() -> None:
    first, second = [1, 1, 1, 1, 0, 1], [0, 1, 0, 0, 1, 0]
    (found,) = compare([_row("rl", 3, first)], [_row("sft", 3, second)])
    assert (found.first_only, found.second_only) == (4, 1)
    assert found.p_value == pytest.approx(2 * (1 + 5) / 32)
    assert found.difference.estimate == pytest.approx(3 / 6)
    line = table([found], "rl", "sft").splitlines()[-1]
    assert line.startswith("| push_cube, sim | 83.3% | 33.3% | +50.0 [")
    assert line.endswith("| 4 | 1 | 0.38 | 6 | 1 |")


def test_seeds_that_one_lacks_are_left_out_and_told(tmp_path: Path) -> None:
    first = [_row("rl", seed, [1, 1, 0, 1]) for seed in (1, 2, 3)]
    second = [_row("sft", seed, [0, 1, 0, 0]) for seed in (3, 2)]
    (found,) = compare(first, second)
    assert (found.seeds, found.left_out, found.episodes) == ((2, 3), (1,), 8)
    # Over seeds: both differ by one half, so the interval has no width.
    assert found.difference == pytest.approx((0.5, 0.5, 0.5))
    files = [_written(tmp_path / "a", *first), _written(tmp_path / "b", *second)]
    said = notes([found], *(read_evaluation(path) for path in files))
    assert "seeds that only one of the two has are left out: [1]" in said


def test_measured_cells_give_the_difference_of_the_committed_table() -> None:
    def rows(prefix: str) -> list[ResultRow]:
        found = []
        for path in sorted(CELLS.glob(f"{prefix}_yaw30_seed*.json")):
            content = json.loads(path.read_text())
            found += [
                cast(ResultRow, row)
                for row in content["rows"]
                if row["domain"] == "yaw30" and row["method"] == prefix
            ]
        return found

    first, second = rows("rl_only"), rows("sft")
    (found,) = compare(first, second)
    # docs/results.md, alignment, yaw 30: rl_only - sft is -10.9 [-17.9, -4.0].
    assert [round(100 * x, 1) for x in found.difference] == [-10.9, -17.9, -4.0]
    assert found.difference == paired_over_seeds(first, second)
    assert found.episodes == 5 * 128


def test_other_initial_states_are_refused() -> None:
    with pytest.raises(RlcoError, match="states_seed is 1 and 2"):
        compare(
            [_row("rl", 0, [1], states_seed=1)], [_row("sft", 0, [0], states_seed=2)]
        )
    with pytest.raises(RlcoError, match="no environment in common: push_cube, sim and"):
        compare([_row("rl", 0, [1])], [_row("sft", 0, [0], domain="locked")])
    with pytest.raises(RlcoError, match=r"seeds \[0\] and \[1\] have none in common"):
        compare([_row("rl", 0, [1])], [_row("sft", 1, [0])])
    with pytest.raises(RlcoError, match="rl has seed 0 twice"):
        compare([_row("rl", 0, [1])] * 2, [_row("sft", 0, [0])])


def test_of_several_methods_one_is_chosen(tmp_path: Path) -> None:
    path = _written(tmp_path / "all", _row("rl", 0, [1, 0]), _row("sft", 0, [0, 0]))
    both = read_evaluation(path)
    assert [row["method"] for row in both.of("sft", "method_a")] == ["sft"]
    with pytest.raises(RlcoError, match="several methods; give method_b= one of rl,"):
        both.of(None, "method_b")
    with pytest.raises(RlcoError, match="no method 'ppo'; give method_a= one of rl,"):
        both.of("ppo", "method_a")


def test_files_of_lerobot_are_paired_task_by_task(tmp_path: Path) -> None:
    paths = (
        _lerobot(tmp_path / "pi", [True, True, True], [False, True]),
        _lerobot(tmp_path / "act", [True, False, False], [False, True]),
    )
    one, other = (read_evaluation(path) for path in paths)
    assert one.methods == ["pi"]
    first, second = compare(one.rows, other.rows)
    assert first.column[0] == "libero 0"
    assert (first.first_only, first.second_only) == (2, 0)
    assert (second.first_only, second.second_only, second.p_value) == (0, 0, 1.0)
    assert any("does not tell its seeds" in x for x in notes([first], one, other))


def test_older_files_of_lerobot_tell_their_seeds(tmp_path: Path) -> None:
    def written(name: str, seeds: list[int]) -> Path:
        episodes = [{"success": True, "seed": seed} for seed in seeds]
        path = tmp_path / name
        path.write_text(json.dumps({"per_episode": episodes}))
        return path

    one, same, other = (
        read_evaluation(written(f"{name}.json", seeds))
        for name, seeds in (("a", [5, 6]), ("b", [5, 6]), ("c", [6, 7]))
    )
    found = compare(one.rows, same.rows)
    assert not any("does not tell" in line for line in notes(found, one, same))
    with pytest.raises(RlcoError, match="began with other seeds"):
        notes(found, one, other)


def test_damaged_files_are_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds neither results"):
        read_evaluation(tmp_path)
    folder = _lerobot(tmp_path / "odd", [True])
    path = folder / "eval_info.json"
    path.write_text(path.read_text().replace("true", '"yes"'))
    with pytest.raises(DataError, match="true or false"):
        read_evaluation(folder)
    path.write_text('{"per_task": []}')
    with pytest.raises(DataError, match="tells of no episode"):
        read_evaluation(folder)
