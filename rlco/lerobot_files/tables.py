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
from rlco.files import few, reading, shown
from rlco.files.reading import cut
from rlco.files.sizes import check_declared
from rlco.lerobot_files.parquet_footer import leaves

# Texts and images are read in parts of a few rows: one of them, repeated, takes no
# place in a file, and what a file declares does not say so. A part may have so many
# rows, and so many bytes if all its values were as large as the largest may be.
_ROWS, _PART = 128, 32 * 2**20


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
                f"as {shown(twice[0])}; write it again with each of them once."
            )
        wanted = [name for name in columns or names if name in names]
        longest = _check_size(file, parquet.metadata.num_rows, wanted)
        if not longest:
            return parquet.read(columns=wanted)
        return _read_in_parts(file, parquet, wanted, longest)


def _check_size(file: Path, rows: int, wanted: Sequence[str]) -> int:
    """Check what is declared; return how long a text or an image may be [bytes].

    None is longer than all that its column stores in a row group; 0 where all values
    are plain numbers.
    """
    columns = tuple(f"{name}." for name in wanted)
    read = [leaf for leaf in leaves(file) if f"{leaf.path}.".startswith(columns)]
    declared = 8 * rows * len(wanted)
    check_declared(file, declared + sum(leaf.declared for leaf in read))
    return max((max(leaf.declared, 1) for leaf in read if not leaf.plain), default=0)


def _read_in_parts(
    file: Path, parquet: pq.ParquetFile, wanted: Sequence[str], longest: int
) -> pa.Table:
    schema = pa.schema([parquet.schema_arrow.field(name) for name in wanted])
    whole: list[pa.Table] = [schema.empty_table()]
    parts: list[pa.RecordBatch] = []
    for part in _parts(file, parquet, wanted, longest):
        parts.append(part)
        # Of thousands of parts a table takes its time to find each row.
        if len(parts) == _ROWS:
            whole.append(pa.Table.from_batches(parts, schema).combine_chunks())
            parts.clear()
    return pa.concat_tables([*whole, pa.Table.from_batches(parts, schema)])


def _parts(
    file: Path, parquet: pq.ParquetFile, wanted: Sequence[str], longest: int
) -> Iterator[pa.RecordBatch]:
    """Yield rows, checking how many bytes they all take.

    Raises:
        DataError: They take much more than the file's own size allows.
    """
    held, rows = 0, 1
    most = min(max(_PART // longest, 1), _ROWS)
    for part in parquet.iter_batches(batch_size=rows, columns=list(wanted)):
        held += part.nbytes
        check_declared(file, held)
        yield part
        # What is declared may be too little: more rows only after small ones.
        fitting = _PART * part.num_rows // max(part.nbytes, 1)
        rows = max(min(2 * rows, most, fitting), 1)
        parquet.reader.set_batch_size(rows)


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
        raise DataError(f"file {str(file)!r} has no column {few([name])}.")
    column = table[name]
    with reading(file, pa.ArrowException):
        values = np.asarray(column.to_numpy())
    numbers = values.dtype.kind in "iuf" and len(values) == table.num_rows
    if not numbers or not np.isfinite(values).all():
        raise DataError(
            f"column {name!r} of file {str(file)!r} holds "
            f"{cut(str(table[name].type))} or nothing where a number is expected; copy "
            "the file again."
        )
    return values


def has_footer(file: Path) -> bool:
    """Return whether a parquet file is complete: closed by its writer and uncut."""
    with reading(file):
        size = file.stat().st_size
        with file.open("rb") as stream:
            stream.seek(max(size - 4, 0))
            return size > 8 and stream.read() == b"PAR1"
