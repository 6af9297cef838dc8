"""The footer's own reader agrees with pyarrow, and survives what pyarrow does not."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rlco.errors import DataError
from rlco.lerobot_files.parquet_footer import leaves
from rlco.lerobot_files.tables import read_table

WIDTH = {"BOOLEAN": 1, "INT32": 4, "FLOAT": 4, "INT64": 8, "DOUBLE": 8}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    table = pa.table(
        {
            "observation.state": pa.array(np.ones((50, 3)).tolist()),
            "action": pa.array(np.zeros((50, 2)).tolist(), pa.list_(pa.float32(), 2)),
            "task": ["push"] * 50,
            "done": [False, True] * 25,
            "camera": pa.array([{"bytes": b"png", "path": None}] * 50),
            "index": pa.array(np.arange(50, dtype=np.int32)),
        }
    )
    pq.write_table(table, tmp_path / "a.parquet", row_group_size=20)
    return tmp_path / "a.parquet"


def test_a_footer_is_read_as_pyarrow_reads_it(file: Path) -> None:
    metadata = pq.ParquetFile(file).metadata
    expected = []
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for column in map(group.column, range(group.num_columns)):
            width = WIDTH.get(column.physical_type)
            size = column.total_uncompressed_size
            declared = size if width is None else width * column.num_values
            expected.append((column.path_in_schema, declared, width is not None))
    found = [(leaf.path, leaf.declared, leaf.plain) for leaf in leaves(file)]
    assert found == expected
    assert len(found) == 3 * 7
    values = {leaf.column: leaf.values // leaf.rows for leaf in leaves(file)}
    assert (values["observation.state"], values["action"]) == (3, 2)


def test_a_damaged_footer_is_refused_or_read_and_ends_no_process(file: Path) -> None:
    """Among them are sizes of histograms over which pyarrow's own access aborts."""
    whole = file.read_bytes()
    length = int.from_bytes(whole[-8:-4], "little")
    draw = random.Random(1)
    refused = 0
    for place in range(len(whole) - 8 - length, len(whole) - 8, 3):
        damaged = bytearray(whole)
        damaged[place] = draw.randrange(256)
        file.write_bytes(damaged)
        try:
            read_table(file)
        except DataError:
            refused += 1
    assert refused > length / 12


@pytest.mark.parametrize(
    "footer", [b"", b"\xff" * 40, b"\x1c" * 5000, b"\x49\xfc\xff\xff\xff\xff\x07"]
)
def test_a_footer_that_is_none(file: Path, footer: bytes) -> None:
    size = len(footer).to_bytes(4, "little")
    file.write_bytes(b"PAR1" + footer + size + b"PAR1")
    with pytest.raises((ValueError, LookupError)):
        list(leaves(file))
    with pytest.raises(DataError):
        read_table(file)
