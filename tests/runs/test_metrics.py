"""The metrics file: exact numbers, and cut back as if nothing had come after."""

from __future__ import annotations

import hashlib
import tracemalloc
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rlco.runs.metrics import MetricsFile, read_metrics

ROWS = st.lists(
    st.dictionaries(st.sampled_from("abcd"), st.floats(), min_size=1),
    min_size=1,
    max_size=6,
)


@settings(max_examples=60, deadline=None)
@given(rows=ROWS, data=st.data())
def test_cut_back_and_continued_equals_never_cut(rows, data) -> None:
    keep = data.draw(st.integers(0, len(rows)))
    with TemporaryDirectory() as folder:
        whole = MetricsFile(Path(folder) / "whole.csv")
        for step, row in enumerate(rows, 1):
            whole.append(step, row)
        killed = Path(folder) / "killed.csv"
        # A killed writer also leaves half a row behind.
        killed.write_bytes(whole.path.read_bytes() + b"99,0.1")
        again = MetricsFile(killed, keep_to=keep)
        for step, row in enumerate(rows[keep:], keep + 1):
            again.append(step, row)
        assert killed.read_bytes() == whole.path.read_bytes()


@given(value=st.floats(allow_nan=False))
@settings(max_examples=50, deadline=None)
def test_floats_read_back_exactly(value: float) -> None:
    with TemporaryDirectory() as folder:
        file = MetricsFile(Path(folder) / "m.csv")
        file.append(1, {"x": value})
        assert read_metrics(file.path) == [{"step": 1.0, "x": value}]


def test_scalars_of_every_kind_are_numbers(tmp_path: Path) -> None:
    file = MetricsFile(tmp_path / "m.csv")
    weight = torch.tensor([0.5], requires_grad=True)
    file.append(
        1, {"t": weight, "n": np.float64(0.25), "i": np.int64(3), "b": True, "f": 2}
    )
    assert file.path.read_text() == "step,t,n,i,b,f\n1,0.5,0.25,3,1,2\n"


def test_step_that_does_not_rise_is_refused_and_nothing_is_written(
    tmp_path: Path,
) -> None:
    file = MetricsFile(tmp_path / "m.csv")
    file.append(2, {"a": 1})
    before = file.path.read_bytes()
    with pytest.raises(ValueError, match="step 2 after step 2"):
        file.append(2, {"a": 2})
    with pytest.raises(TypeError, match="metric 'a' is a str"):
        file.append(3, {"a": "high"})
    with pytest.raises(TypeError, match="metric 'a' is a Tensor"):
        file.append(3, {"a": torch.zeros(2)})
    with pytest.raises(ValueError, match="cannot name a column"):
        file.append(3, {"a,b": 1})
    assert file.path.read_bytes() == before


def test_without_a_checkpoint_no_row_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    MetricsFile(path).append(1, {"a": 1})
    assert MetricsFile(path, keep_to=None).last_step is None
    assert path.read_bytes() == b""


def test_a_long_table_stays_in_its_file_alone(tmp_path: Path) -> None:
    """A run of hours has tens of thousands of rows, each of kilobytes in memory."""
    file = MetricsFile(tmp_path / "m.csv")
    row = {f"loss_{name}": 0.1 for name in range(20)}
    file.append(1, row)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for step in range(2, 1002):
            file.append(step, row)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 100_000
    assert [found["step"] for found in file.rows()] == list(range(1, 1002))


def test_the_digest_is_that_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"

    def digest() -> str:
        content = path.read_bytes() if path.exists() else b""
        return hashlib.sha256(content).hexdigest()

    file = MetricsFile(path)
    assert file.digest() == digest()
    for step, row in enumerate(({"a": 1}, {"a": 2}, {"a": 3, "b": 4}, {"b": 5}), 1):
        file.append(step, row)
        assert file.digest() == digest()
    again = MetricsFile(path, keep_to=3)
    assert again.digest() == digest()
    again.append(4, {"b": 5})
    assert again.digest() == file.digest()
