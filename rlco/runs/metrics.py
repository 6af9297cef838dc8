"""A CSV file with one row per step, that a resumed run continues byte for byte."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rlco.errors import RlcoError
from rlco.files import reading
from rlco.runs.whole_files import sync_folder


class MetricsFile:
    """A CSV file of numbers: one header, one row per step, steps increasing.

    A name that first appears in a later row becomes a new last column; the file is
    then rewritten, with that column empty above. Numbers are written so that they
    read back exactly.

    Args:
        path: The file; made by the first row, continued where it exists.
        keep_to: Last step to keep of an existing file; later rows, a row that was
            cut off, and columns that only those rows filled are dropped, so that
            the file is as it was after that step. None keeps no row.

    Example:
        >>> import tempfile
        >>> file = MetricsFile(Path(tempfile.mkdtemp()) / "metrics.csv")
        >>> file.append(1, {"loss": 0.1})
        >>> file.append(2, {"loss": 0.25, "success_rate": 1})
        >>> print(file.path.read_text(), end="")
        step,loss,success_rate
        1,0.1,
        2,0.25,1
    """

    def __init__(self, path: Path, *, keep_to: int | None = None) -> None:
        self.path = path
        # Rows stay in the file alone: a long run has more of them than fit a memory.
        self._columns: list[str] = []
        self._last: dict[str, str] = {}
        self._hash = hashlib.sha256()
        if path.exists():
            self._restore(keep_to)

    @property
    def last_step(self) -> int | None:
        """The step of the last row."""
        return int(self._last["step"]) if self._last else None

    def append(self, step: int, row: Mapping[str, Any]) -> None:
        """Write one row; it is with the operating system when this returns.

        Args:
            step: Greater than that of the last row.
            row: Numbers by name; scalar tensors and arrays count as numbers.

        Raises:
            ValueError: The step does not rise, or a name is not a plain column name.
            TypeError: A value is not a number.
        """
        if self.last_step is not None and step <= self.last_step:
            raise ValueError(f"step {step} after step {self.last_step}: steps rise")
        cells = {"step": str(int(step))}
        for name, value in row.items():
            if name == "step" or not name or set(name) & set(',"\r\n'):
                raise ValueError(f"{name!r} cannot name a column")
            cells[name] = _number(name, value)
        added = [name for name in cells if name not in self._columns]
        if added:
            rows = [*self._read(), cells]
            self._columns += added
            self._rewrite(rows)
        else:
            line = _line(cells, self._columns)
            with self.path.open("a", encoding="utf-8", newline="") as file:
                file.write(line)
            self._hash.update(line.encode())
        self._last = cells

    def rows(self) -> list[dict[str, float]]:
        """Return every row as numbers by name, without the cells that are empty."""
        return [{k: float(v) for k, v in row.items()} for row in self._read()]

    @property
    def last(self) -> dict[str, float]:
        """The last row, as in :meth:`rows`."""
        return {name: float(cell) for name, cell in self._last.items()}

    def sync(self) -> None:
        """Wait until every row is on the disk, not only with the operating system."""
        if self.path.exists():
            with self.path.open("rb") as file:
                os.fsync(file.fileno())
            sync_folder(self.path.parent)  # it was renamed where a column came

    def digest(self) -> str:
        """Return the SHA-256 of what was written, of nothing where nothing was."""
        return self._hash.copy().hexdigest()

    def _read(self) -> list[dict[str, str]]:
        """Return the cells of every row that are not empty."""
        if not self._last:
            return []
        with self.path.open(encoding="utf-8", newline="") as file:
            return [{k: v for k, v in row.items() if v} for row in csv.DictReader(file)]

    def _restore(self, keep_to: int | None) -> None:
        rows: list[dict[str, str]] = []
        advice = "put the table of this run back, or start a new run"
        with reading(self.path, csv.Error, advice=advice, error=RlcoError):
            text = self.path.read_bytes().decode("utf-8")
            # A killed writer may cut its last row; a power cut leaves zeros for rows.
            text = text.partition("\0")[0]
            whole = text[: text.rfind("\n") + 1]
            reader = csv.DictReader(io.StringIO(whole, newline=""), strict=True)
            last = -1 if keep_to is None else keep_to
            kept = (row for row in reader if int(row["step"]) <= last)
            rows += ({k: v for k, v in row.items() if v} for row in kept)
            for row in rows:  # whether all of them are numbers
                [float(cell) for cell in row.values()]
            self._columns = [
                name
                for name in reader.fieldnames or []
                if any(name in row for row in rows)
            ]
        self._rewrite(rows)
        self._last = rows[-1] if rows else {}

    def _rewrite(self, rows: Sequence[dict[str, str]]) -> None:
        header = [",".join(self._columns) + "\n"] if self._columns else []
        lines = [*header, *(_line(row, self._columns) for row in rows)]
        part = self.path.with_name(f".{self.path.name}.part")
        with part.open("w", encoding="utf-8", newline="") as file:
            file.writelines(lines)
            file.flush()
            os.fsync(file.fileno())  # else a power cut after the renaming empties it
        part.replace(self.path)
        self._hash = hashlib.sha256("".join(lines).encode())


def read_metrics(path: Path) -> list[dict[str, float]]:
    """Read a metrics file without changing it; empty cells are left out."""
    with (
        reading(path, csv.Error),
        path.open(encoding="utf-8", newline="") as file,
    ):
        return [
            {name: float(cell) for name, cell in row.items() if cell}
            for row in csv.DictReader(file)
        ]


def _line(cells: Mapping[str, str], columns: list[str]) -> str:
    return ",".join(cells.get(name, "") for name in columns) + "\n"


def _number(name: str, value: Any) -> str:
    if hasattr(value, "item"):
        # Scalar arrays and tensors, without importing torch for it; what holds
        # several numbers refuses and is named below.
        with contextlib.suppress(ValueError, RuntimeError):
            value = value.item()
    if isinstance(value, bool | int):
        return str(int(value))
    if isinstance(value, float):
        return repr(value)
    raise TypeError(f"metric {name!r} is a {type(value).__name__}, not one number")
