"""What watches a long training: sizes, slopes, and the end of it."""

import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest
import soak


def test_a_file_that_is_taken_away_while_it_is_measured_counts_nothing(
    tmp_path: Path,
) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "table.csv").write_bytes(b"123")
    (tmp_path / "gone").symlink_to(tmp_path / "nothing")  # listed, and not there
    assert list(soak.sizes_in(tmp_path)) == [3]


def test_a_growth_is_found_beside_its_noise() -> None:
    noise = np.random.default_rng(0).normal(size=500)
    rows = [
        {"frames": 1000.0 * step, "memory_mb": 7.0 + 40e-3 * step + extra}
        for step, extra in enumerate(noise)
    ]
    rate, unsure = soak.slope(rows, "memory_mb")  # 40 MB in a million frames
    assert abs(rate - 40.0) < unsure < 2.0


@pytest.mark.parametrize("table", ["step,frames\n1,512\n", None])
def test_training_ends_where_enough_is_measured_and_where_nothing_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str | None
) -> None:
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "step_0000001.safetensors").touch()
    if table is not None:
        (tmp_path / "metrics.csv").write_text(table)
    sent: list[int] = []
    monkeypatch.setattr(os, "kill", lambda _, number: sent.append(number))
    rows: list[dict[str, float]] = []
    call = (tmp_path, rows, np.inf, 512.0, threading.Event())
    if table is None:
        with pytest.raises(FileNotFoundError):
            soak.watch(*call)
    else:
        soak.watch(*call)
    assert [row["frames"] for row in rows] == [512] * (table is not None)
    # Not Ctrl-C's, which a shell keeps from what it starts in the background.
    assert sent == [signal.SIGTERM]
