"""Cells that hold a list: ``[0.1, 0.2]``, ``0.1 0.2`` or ``['elbow', 'wrist']``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from rlco.errors import DataError

_BRACKETS = re.compile(r"^(?:np\.)?(?:array)?\s*[\[(]+(.*?)[\])]+$", re.DOTALL)
_NUMBER = re.compile(r"[-+]?(?:\d|\.\d|nan|inf)", re.IGNORECASE)


def split_lists(cells: Sequence[str]) -> list[list[str]] | None:
    """Return the parts of each cell of a column of lists; None where it is none.

    A list is in brackets, or it is two numbers or more with blanks or commas between
    them.

    Example:
        >>> split_lists(["[0.1, 0.2]", "[0.3, 0.4]"]), split_lists(["0.1 0.2"])
        ([['0.1', '0.2'], ['0.3', '0.4']], [['0.1', '0.2']])
        >>> split_lists(["0,5", "1"]), split_lists(["left arm"])
        (None, None)
    """
    first = next((cell for cell in cells if cell), "")
    bare = _BRACKETS.match(first)
    if bare is None and not _are_numbers(first):
        return None
    return [_parts(cell) for cell in cells]


def list_columns(
    path: Path, lists: Mapping[str, Sequence[Sequence[str]]]
) -> dict[str, list[str]]:
    """Return a column of cells for each number of lists, named by what names them.

    Names are those of a list of words as long as the others that never changes, as in
    a joint state's ``name``; else a count from 0.

    Raises:
        DataError: Lists of one column differ in length.

    Example:
        >>> list_columns(Path("a.csv"), {"name": [["hip", "knee"]] * 2,
        ...                              "position": [["1", "2"], ["3", "4"]]})
        {'position.hip': ['1', '3'], 'position.knee': ['2', '4']}
    """
    words = {
        len(rows[0]): list(rows[0])
        for rows in lists.values()
        if rows[0] and not _NUMBER.match(rows[0][0]) and _same(rows)
    }
    columns: dict[str, list[str]] = {}
    for name, rows in lists.items():
        size = len(rows[0])
        if size and not _NUMBER.match(rows[0][0]):
            continue
        for number, row in enumerate(rows):
            if len(row) != size:
                raise DataError(
                    f"column {name!r} of {str(path)!r} holds a list of {len(row)} in "
                    f"row {number + 1} and of {size} in the first; correct or delete "
                    "that row."
                )
        whose = words.get(size, [str(i) for i in range(size)])
        columns |= {f"{name}.{n}": [r[i] for r in rows] for i, n in enumerate(whose)}
    return columns


def _same(rows: Sequence[Sequence[str]]) -> bool:
    return all(row == rows[0] for row in rows)


def _are_numbers(cell: str) -> bool:
    # A comma alone may be a decimal one.
    parts = cell.split()
    return len(parts) > 1 and all(_NUMBER.match(part) for part in parts)


def _parts(cell: str) -> list[str]:
    bare = _BRACKETS.match(cell)
    inside = cell if bare is None else bare[1]
    parts = inside.split(",") if "," in inside else inside.split()
    return [part.strip().strip("\"'") for part in parts if part.strip()]
