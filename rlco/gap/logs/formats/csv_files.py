"""CSV files with a header."""

from __future__ import annotations

import csv
import io
from collections import Counter
from pathlib import Path

import numpy as np

from rlco.errors import DataError, counted
from rlco.files import few, reading, shown
from rlco.files.texts import read_text
from rlco.gap.logs.formats.columns import tables_of
from rlco.gap.logs.formats.list_cells import list_columns, split_lists
from rlco.gap.logs.log import Array
from rlco.gap.logs.table import Table
from rlco.gap.model import LoadedModel

#: Columns; a robot of sixty joints has some hundreds.
_MOST = 4096
_WORDS = {"true": "1", "false": "0", "": "nan", "none": "nan", "null": "nan"}


def read_csv(path: Path, model: LoadedModel | None) -> list[Table]:
    """Read a CSV file: a row of headers, then numbers.

    Commas, semicolons, tabs or blanks separate; lines that start with ``#`` are
    comments, but the last one before the numbers may be the header. See
    `rlco.gap.logs.formats.headers` for what headers mean. A column ``episode``
    separates recordings. Cells may be quoted, and hold a list, which then counts as
    a column a number (see `rlco.gap.logs.formats.list_cells`). Columns of text are left
    out, and noted.

    Raises:
        DataError: There is no header or no time, a row is too short or too long, or a
            cell is no number.
    """
    header, cells, separator = _lines(path)
    for number, row in enumerate(cells):
        if len(row) != len(header):
            raise DataError(
                f"row {number + 1} of {str(path)!r} has {counted(len(row), 'cell')} "
                f"and the header {len(header)}; correct or delete that row."
            )
    columns: dict[str, Array] = {}
    lists: dict[str, list[list[str]]] = {}
    texts = []
    for index, name in enumerate(header):
        column = [row[index] for row in cells]
        parts = split_lists(column)
        if parts is not None:
            lists[name] = parts
            continue
        values = _numbers(path, name, column, separator)
        if values is None:
            texts.append(name)
        else:
            columns[name] = values
    for name, column in list_columns(path, lists).items():
        values = _numbers(path, name, column, separator)
        if values is not None:
            columns[name] = values
    if not columns:
        raise DataError(f"file {str(path)!r} holds no numbers.")
    notes = [f"Columns of text are left out: {few(texts)}."] if texts else []
    return tables_of(path.stem, columns, model, notes=notes)


def _lines(path: Path) -> tuple[list[str], list[list[str]], str | None]:
    """Return the header, the rows of cells under it, and what separates them."""
    text = read_text(path, encoding="utf-8-sig", advice="give a CSV file")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    comments = [line.lstrip("# ") for line in lines if line.startswith("#")]
    plain = [line for line in lines if not line.startswith("#")]
    if len(plain) < 2:
        raise DataError(f"file {str(path)!r} holds no rows under a header.")
    separator = _separator(_unquoted(plain[0]))
    if '"' in text and separator is not None:
        # A quoted cell may hold separators and line breaks.
        source = io.StringIO("\n".join(plain), newline="")
        read = csv.reader(source, delimiter=separator, skipinitialspace=True)
        with reading(path, csv.Error):
            rows = [[cell.strip() for cell in row] for row in read]
    else:
        rows = [_cells(line, separator) for line in plain]
    if all(_is_number(cell) for cell in rows[0]):
        # numpy.savetxt writes the header as a comment.
        rows = [_cells(comments[-1] if comments else "", separator), *rows]
        if len(rows[0]) != len(rows[1]):
            raise DataError(
                f"file {str(path)!r} has no header; name its columns in a first row, "
                "such as time,q1,q2,command1,command2."
            )
    header = rows[0]
    if len(header) > _MOST:
        raise DataError(
            f"file {str(path)!r} has {len(header)} columns, and at most {_MOST} are "
            "read; leave out those that are not of the robot."
        )
    counts = Counter(header)
    twice = sorted(name for name, count in counts.items() if name and count > 1)
    if twice:
        raise DataError(
            f"file {str(path)!r} has several columns named {few(twice)}; give each its "
            "own name."
        )
    return header, rows[1:], separator


def _unquoted(line: str) -> str:
    """Return a line without what is quoted: names may hold a separator."""
    return "".join(line.split('"')[::2])


def _separator(header: str) -> str | None:
    counts = {mark: header.count(mark) for mark in (",", ";", "\t")}
    most = max(counts, key=lambda mark: counts[mark])
    return most if counts[most] else None


def _cells(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip("\"'") for cell in line.split(separator)]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _numbers(
    path: Path, name: str, cells: list[str], separator: str | None
) -> Array | None:
    """Return a column's numbers, NaN where a cell is empty; None where it is text."""
    try:
        return np.array(cells, dtype=float)
    except ValueError:
        pass
    if separator == ";":
        cells = [cell.replace(",", ".") for cell in cells]
    cells = [_WORDS.get(cell.lower(), cell) for cell in cells]
    good = [_is_number(cell) for cell in cells]
    if all(good):
        return np.array(cells, dtype=float)
    if sum(good) > len(good) / 2:
        row = good.index(False)
        raise DataError(
            f"column {name!r} of {str(path)!r} holds {shown(cells[row])} in row "
            f"{row + 1}, which is not a number; correct or delete that row."
        )
    return None
