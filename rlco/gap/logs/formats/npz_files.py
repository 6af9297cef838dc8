"""NPZ files, whose arrays are columns, whole channels, or rows with their lengths."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError
from rlco.gap.logs.formats.columns import tables_of
from rlco.gap.logs.formats.headers import POSE, parse_header
from rlco.gap.logs.log import Array
from rlco.gap.logs.matching import few
from rlco.gap.logs.table import Table
from rlco.gap.model import LoadedModel

#: Arrays that name the columns of others.
_NAMES = ("columns", "header", "names", "joint_names", "joints")
_LENGTHS = ("length", "lengths", "episode_lengths")
_MOTION = ("vx", "vy", "vz", "wx", "wy", "wz")
_WHOLE = "data"


def read_npz(path: Path, model: LoadedModel | None) -> list[Table]:
    """Read an NPZ file.

    An array of T numbers is the column of its name, one of shape (T, n) a channel
    such as ``position`` or ``action`` (``joint_names`` may name its columns), ``data``
    of shape (T, n) has its columns named by ``columns``; without, 7 are a free body's
    place and quaternion (w, x, y, z), and 13 also its velocities. ``length`` says
    recordings apart that lie one after the other. Single numbers are facts; more may
    lie in a JSON file beside it, where ``dt`` is the seconds of a row.

    Raises:
        DataError: The file is damaged, its arrays differ in length, or nothing says
            the times.
    """
    arrays = _arrays(path)
    names = _strings(arrays)
    lengths = next((arrays[k] for k in _LENGTHS if k in arrays), None)
    facts, notes = _facts(path, arrays)
    tables = {k: a for k, a in arrays.items() if a.ndim in (1, 2)}
    rows = _rows(path, tables, lengths)
    columns: dict[str, Array] = {}
    for key, array in tables.items():
        if len(array) == rows and array.dtype.kind in "fiub":
            columns |= _columns(path, key, array.astype(float), names, model)
    period = facts.get("dt", 1.0 / facts["fps"] if facts.get("fps") else None)
    counts = None if lengths is None else lengths.astype(int).tolist()
    found = tables_of(
        path.stem,
        columns,
        model,
        period=period,
        facts=facts,
        lengths=counts,
        notes=notes,
    )
    return found if counts is None else _with_facts(found, tables)


def _with_facts(
    found: list[Table], arrays: dict[str, NDArray[np.generic]]
) -> list[Table]:
    """Add arrays of one number a recording to the facts of each."""
    each = {
        key: array.astype(float)
        for key, array in arrays.items()
        if array.shape == (len(found),) and array.dtype.kind in "fiub"
    }
    return [
        replace(
            table, facts={**table.facts, **{k: float(a[i]) for k, a in each.items()}}
        )
        for i, table in enumerate(found)
    ]


def _arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except (ValueError, OSError, EOFError, BadZipFile) as error:
        raise DataError(
            f"file {str(path)!r} cannot be read as NPZ ({error}); save plain arrays "
            "with numpy.savez."
        ) from None


def _strings(arrays: dict[str, NDArray[np.generic]]) -> list[str] | None:
    for key in _NAMES:
        if key in arrays and arrays[key].dtype.kind in "US":
            return [str(name) for name in np.ravel(arrays[key]).astype(str)]
    return None


def _facts(
    path: Path, arrays: dict[str, NDArray[np.generic]]
) -> tuple[dict[str, float], list[str]]:
    facts = {
        key: float(array.astype(float).ravel()[0])
        for key, array in arrays.items()
        if array.size == 1 and array.ndim == 0 and array.dtype.kind in "fiub"
    }
    beside = path.with_suffix(".json")
    others = sorted(path.parent.glob("*.json"))
    if not beside.is_file() and len(others) == 1:
        beside = others[0]
    if not beside.is_file():
        return facts, []
    try:
        content = json.loads(beside.read_text())
    except ValueError as error:
        raise DataError(f"file {str(beside)!r} is not valid JSON ({error}).") from None
    numbers = {
        key: float(value)
        for key, value in (content.items() if isinstance(content, dict) else ())
        if isinstance(value, (int, float)) and not isinstance(value, bool)
    }
    note = f"Facts were read from {beside.name}: {few(list(numbers))}."
    return {**numbers, **facts}, [note] if numbers else []


def _rows(
    path: Path,
    tables: dict[str, NDArray[np.generic]],
    lengths: NDArray[np.generic] | None,
) -> int:
    if lengths is not None:
        return int(np.sum(lengths.astype(int)))
    sizes = {key: len(a) for key, a in tables.items() if a.dtype.kind in "fiub"}
    if not sizes:
        raise DataError(f"file {str(path)!r} holds no arrays of numbers.")
    times = [n for key, n in sizes.items() if key.lower().startswith(("time", "t"))]
    rows = times[0] if times else max(sizes.values())
    odd = [f"{key} {n}" for key, n in sizes.items() if n != rows and n > 1]
    if odd:
        raise DataError(
            f"arrays of {str(path)!r} differ in length: {few(odd)}, and {rows} rows; "
            "give recordings of their own in files of their own, or 'length'."
        )
    return rows


def _columns(
    path: Path,
    key: str,
    array: Array,
    names: list[str] | None,
    model: LoadedModel | None,
) -> dict[str, Array]:
    if array.ndim == 1:
        return {key: array}
    count = array.shape[1]
    if key == _WHOLE or key == "pose":
        named = names if names and len(names) == count else None
        if named is None and count in (7, 13):
            named = [*POSE, *_MOTION][:count]
        if named is None:
            raise DataError(
                f"array {key!r} of {str(path)!r} has {count} columns without names; "
                "save their names as an array 'columns'."
            )
        return {name: array[:, i] for i, name in enumerate(named)}
    if parse_header(key).kind != "extra" and count == 1:
        return {key: array[:, 0]}
    whose = names if names and len(names) == count else [str(i) for i in range(count)]
    return {f"{key}.{name}": array[:, i] for i, name in enumerate(whose)}
