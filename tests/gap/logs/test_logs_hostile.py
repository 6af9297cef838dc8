"""Logs made to fill a memory or a day: refused by what they declare."""

from __future__ import annotations

import io
import json
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_cases import write_csv

from rlco.errors import DataError
from rlco.gap.logs.formats.npz_files import read_npz
from rlco.gap.logs.read import read_log

TIME = np.arange(50) / 25.0


def test_an_array_with_a_header_that_fills_a_memory(tmp_path: Path) -> None:
    long = b"\x93NUMPY\x02\x00" + (1_300_000_000).to_bytes(4, "little") + 100 * b" "
    file = npz(tmp_path / "a.npz", time=npy(TIME), q=long)
    with pytest.raises(DataError, match="a header of 1300000000 bytes, of at most"):
        read_npz(file, None)


def npz(file: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return file


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def header(shape: tuple[int, ...]) -> bytes:
    """The start of an array of a shape, and nothing of its content."""
    stream = io.BytesIO()
    said = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, said)
    return stream.getvalue()


def test_an_array_that_declares_more_than_its_file(tmp_path: Path) -> None:
    file = npz(tmp_path / "a.npz", time=npy(TIME), q=header((10**12,)))
    with pytest.raises(DataError, match=r"declares 8000000.0 MB of numbers"):
        read_npz(file, None)


def test_an_array_that_is_no_column_is_not_read(tmp_path: Path) -> None:
    # Its content is missing: to read it would fail.
    file = npz(
        tmp_path / "a.npz", time=npy(TIME), q=npy(TIME), film=header((300, 480, 640, 3))
    )
    (table,) = read_npz(file, None)
    assert [column.header for column, _ in table.columns] == ["q"]


def test_arrays_of_objects_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time=TIME, q=np.array([{}] * len(TIME)))
    with pytest.raises(DataError, match=r"array 'q' of .* holds Python objects"):
        read_npz(tmp_path / "a.npz", None)


@pytest.mark.parametrize(
    "lengths", [[], [2.5], [-1], [0], ["a"], [[1]], [2**70], [np.nan]]
)
def test_lengths_that_are_none(tmp_path: Path, lengths: list[Any]) -> None:
    given = np.array(lengths)
    if given.dtype == object:
        given = given.astype(float)
    np.savez(tmp_path / "a.npz", time=TIME, q=TIME, lengths=given)
    with pytest.raises(DataError, match=r"lengths in .* give the rows of each record"):
        read_npz(tmp_path / "a.npz", None)


def test_a_name_of_many_characters(tmp_path: Path) -> None:
    file = write_csv(tmp_path / "a.csv", {"time": TIME, "q" * 20_000: TIME})
    started = time.process_time()
    with pytest.raises(DataError, match=r"name has 20000 characters, 'qqqq.* at most"):
        read_log(file)
    assert time.process_time() - started < 5


def test_columns_without_end(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    names = ["time", *(f"q{i}" for i in range(60_000))]
    row = ",".join(["0.1"] * len(names))
    file.write_text("\n".join([",".join(names), row, row]))
    with pytest.raises(DataError, match="has 60001 columns, and at most 4096"):
        read_log(file)


@pytest.mark.parametrize(
    "content",
    [
        [],
        {"entries": []},
        {"entries": 3},
        {"entries": [3]},
        {"entries": [{"timestamp": 1, "position": 1}, {"timestamp": 1}]},
        {
            "entries": [
                {"timestamp": 1, "position": 1},
                {"timestamp": 1, "position": {}},
            ]
        },
        {"entries": [{"timestamp": 10**400, "position": 1}]},
        {"entries": [{"position": 1}], "motor": {}},
    ],
)
def test_json_of_another_form_than_bam(tmp_path: Path, content: object) -> None:
    file = tmp_path / "a.json"
    file.write_text(json.dumps(content))
    with pytest.raises(DataError, match=r"a\.json"):
        read_log(file)


def test_escapes_in_a_header_stay_out_of_messages(tmp_path: Path) -> None:
    # Named in a row, without the quotes that would escape them.
    columns = {"time": TIME, "\x1b[2Jq1": TIME, "\x1b[2Jq2": TIME[:]}
    file = write_csv(tmp_path / "a.csv", columns)
    with pytest.raises(DataError) as caught:
        read_log(file, rename={"nobody": "q1"})
    assert "\\x1b[2Jq1" in str(caught.value)
    assert "\x1b" not in str(caught.value)
