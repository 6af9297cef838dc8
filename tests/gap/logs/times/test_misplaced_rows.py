"""Rows that a bad stamp puts a tick off, found by the motion."""

from __future__ import annotations

import numpy as np
import pytest

from rlco.gap.logs.times import misplaced_rows as module
from rlco.gap.logs.times.misplaced_rows import misplaced_rows


def logged(lost: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Ticks and positions of two moving joints, of which one row is lost."""
    ticks = np.delete(np.arange(60.0), lost)
    path = np.sin(0.1 * ticks[:, None] * [1.0, 2.0])
    path += np.random.default_rng(seed).normal(0.0, 1e-3, path.shape)
    return ticks, path


def found(ticks: np.ndarray, path: np.ndarray) -> list[int]:
    return np.flatnonzero(misplaced_rows(ticks, path)).tolist()


@pytest.mark.parametrize("size", [1, 2, 3])
def test_a_short_run_on_the_wrong_side_of_a_lost_row_is_found(size: int) -> None:
    ticks, path = logged(30)
    assert found(ticks, path) == []
    ticks[30 : 30 + size] -= 1.0
    assert found(ticks, path) == list(range(30, 30 + size))


def test_a_row_with_the_measurement_before_does_not_make_its_neighbours_wrong() -> None:
    ticks, path = logged(30)
    # The row after the lost one holds what the lost one should have.
    path[30] = np.sin(0.1 * 30.0 * np.array([1.0, 2.0]))
    assert found(ticks, path) == [30]


def test_a_row_whose_stamp_is_of_another_time_is_left_as_it_is() -> None:
    ticks, path = logged(30)
    ticks[29] = -19.0
    assert 29 not in found(ticks, path)


def test_a_last_row_of_the_tick_after_is_found_though_nothing_follows_it() -> None:
    ticks, path = logged(58)
    assert found(ticks, path) == []
    ticks[-1] -= 1.0
    assert found(ticks, path) == [len(ticks) - 1]


@pytest.mark.parametrize("place", [20, -1])
def test_a_stamp_of_another_age_is_compared_with_no_tick_between(
    place: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared: list[float] = []
    off = module._off

    def noted(tick: float, *more: np.ndarray) -> float:
        compared.append(tick)
        return off(tick, *more)

    monkeypatch.setattr(module, "_off", noted)
    ticks, path = logged(30)
    ticks[place] = 1e5
    assert (len(ticks) - 1 if place < 0 else place) not in found(ticks, path)
    assert len(compared) < 1000


def test_runs_far_apart_are_found_as_each_is_alone() -> None:
    lost = np.arange(20, 300, 20)
    ticks = np.delete(np.arange(320.0), lost)
    path = np.sin(0.1 * ticks[:, None] * [1.0, 2.0])
    path += np.random.default_rng(0).normal(0.0, 1e-3, path.shape)
    firsts = np.searchsorted(ticks, lost)
    moved, each = ticks.copy(), []
    for number, first in enumerate(firsts):
        run = slice(first, first + 1 + number % 3)
        moved[run] -= 1.0
        alone = ticks.copy()
        alone[run] -= 1.0
        each += found(alone, path)
    assert len(each) == sum(1 + number % 3 for number in range(len(firsts)))
    assert found(moved, path) == each
