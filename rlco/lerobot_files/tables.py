"""Read parquet and JSON lines, and report damage in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rlco.errors import DataError


def read_table(file: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a parquet file; columns that it lacks are skipped.

    Raises:
        DataError: If it is missing, truncated or damaged.
    """
    try:
        with pq.ParquetFile(file) as parquet:
            return parquet.read(columns=columns)
    except FileNotFoundError:
        raise DataError(f"file {str(file)!r} is missing; copy it again.") from None
    except (pa.ArrowException, OSError) as error:
        reason = str(error).split("\n", 1)[0].rstrip(".")
        raise DataError(
            f"file {str(file)!r} is truncated or damaged ({reason}); copy it again."
        ) from None


def read_jsonl(file: Path) -> list[dict[str, Any]]:
    """Read one JSON object per line.

    Raises:
        DataError: If the file is missing, truncated or damaged.
    """
    try:
        lines = file.read_text().splitlines()
        return [json.loads(line) for line in lines if line.strip()]
    except FileNotFoundError:
        raise DataError(f"file {str(file)!r} is missing; copy it again.") from None
    except ValueError as error:
        raise DataError(
            f"file {str(file)!r} is truncated or damaged ({error}); copy it again."
        ) from None


def has_footer(file: Path) -> bool:
    """Return whether a parquet file is complete: closed by its writer and uncut."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(max(size - 4, 0))
        return size > 8 and stream.read() == b"PAR1"
