"""Read parquet files: declared sizes first, damage in one sentence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from rlco.errors import DataError, counted
from rlco.files import reading
from rlco.files.sizes import check_declared
from rlco.lerobot_files.parquet_footer import leaves

# Rows of texts or images read at a time: one of them, repeated, takes no place in a
# file, and what a file declares does not say so.
_AT_ONCE = 128


def read_table(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a parquet file; columns that it lacks are skipped.

    Raises:
        DataError: If it is missing, truncated or damaged, has two columns of one name,
            or declares much more than its own size allows.
    """
    with reading(file, pa.ArrowException), pq.ParquetFile(file) as parquet:
        names = parquet.schema_arrow.names
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise DataError(
                f"file {str(file)!r} has {counted(len(twice), 'column')} twice, such "
                f"as {twice[0]!r}; write it again with each of them once."
            )
        wanted = [name for name in columns or names if name in names]
        plain = _check_size(file, parquet.metadata.num_rows, wanted)
        if plain:
            return parquet.read(columns=wanted)
        return _read_in_parts(file, parquet, wanted)


def _check_size(file: Path, rows: int, wanted: Sequence[str]) -> bool:
    """Check what is declared; return whether all of it are plain numbers."""
    columns = tuple(f"{name}." for name in wanted)
    read = [leaf for leaf in leaves(file) if f"{leaf.path}.".startswith(columns)]
    declared = 8 * rows * len(wanted)
    check_declared(file, declared + sum(leaf.declared for leaf in read))
    return all(leaf.plain for leaf in read)


def _read_in_parts(
    file: Path, parquet: pq.ParquetFile, wanted: Sequence[str]
) -> pa.Table:
    def parts() -> Iterator[pa.RecordBatch]:
        held = 0
        for part in parquet.iter_batches(batch_size=_AT_ONCE, columns=list(wanted)):
            held += part.nbytes
            check_declared(file, held)
            yield part

    schema = pa.schema([parquet.schema_arrow.field(name) for name in wanted])
    return pa.Table.from_batches(list(parts()), schema)


def whole_numbers(file: Path, table: pa.Table, name: str) -> npt.NDArray[np.int64]:
    """Return a column of whole numbers, (rows,).

    Raises:
        DataError: If there is no such column, or a value is missing or is no such
            number.
    """
    values = _numbers(file, table, name)
    whole = values.astype(np.int64)
    if not np.array_equal(whole, values):
        raise DataError(
            f"column {name!r} of file {str(file)!r} holds other than whole numbers; "
            "copy the file again."
        )
    return whole


def real_numbers(file: Path, table: pa.Table, name: str) -> npt.NDArray[np.float64]:
    """Return a column of finite numbers, (rows,).

    Raises:
        DataError: As in `whole_numbers`.
    """
    return _numbers(file, table, name).astype(np.float64)


def _numbers(file: Path, table: pa.Table, name: str) -> npt.NDArray[np.generic]:
    if name not in table.column_names:
        raise DataError(f"file {str(file)!r} has no column {name}.")
    column = table[name]
    with reading(file, pa.ArrowException):
        values = np.asarray(column.to_numpy())
    numbers = values.dtype.kind in "iuf" and len(values) == table.num_rows
    if not numbers or not np.isfinite(values).all():
        raise DataError(
            f"column {name!r} of file {str(file)!r} holds {table[name].type} or "
            "nothing where a number is expected; copy the file again."
        )
    return values


def has_footer(file: Path) -> bool:
    """Return whether a parquet file is complete: closed by its writer and uncut."""
    with reading(file):
        size = file.stat().st_size
        with file.open("rb") as stream:
            stream.seek(max(size - 4, 0))
            return size > 8 and stream.read() == b"PAR1"
