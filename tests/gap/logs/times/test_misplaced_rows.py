"""Rows that a bad stamp puts a tick off, found by the motion."""

from __future__ import annotations

import numpy as np
import pytest

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
