"""Logs with bad times: what is wrong with them, and nothing else."""

from __future__ import annotations

import gap_timing
import numpy as np

ROWS = 400


def _faulty(way: str) -> dict[str, np.ndarray]:
    count = np.arange(float(ROWS))
    rows = {"time": count * 0.02, "state": count[:, None], "action": count[:, None]}
    return gap_timing.faulty(rows, way, np.random.default_rng(0))


def test_lost_rows_lose_everything() -> None:
    rows = _faulty("lost")
    assert 0.9 * ROWS < len(rows["time"]) < ROWS
    np.testing.assert_array_equal(rows["state"], rows["action"])
    np.testing.assert_allclose(rows["time"], rows["state"][:, 0] * 0.02)


def test_jittering_stamps_change_nothing_else() -> None:
    rows = _faulty("stamps")
    off = rows["time"] - np.arange(ROWS) * 0.02
    assert 0.9 < float(off.std()) / (gap_timing._JITTER * 0.02) < 1.1
    np.testing.assert_array_equal(rows["state"][:, 0], np.arange(ROWS))


def test_repeated_rows_show_what_was_shown_and_send_what_is_sent() -> None:
    rows = _faulty("repeated")
    state = rows["state"][:, 0]
    np.testing.assert_array_equal(rows["action"][:, 0], np.arange(ROWS))
    fresh = state == np.arange(ROWS)
    assert 0.9 < fresh.mean() < 1.0
    np.testing.assert_array_equal(state[1:][~fresh[1:]], state[:-1][~fresh[1:]])
