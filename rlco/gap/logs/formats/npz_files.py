"""NPZ files, whose arrays are columns, whole channels, or rows with their lengths."""

from __future__ import annotations

import io
import math
import tokenize
from dataclasses import replace
from pathlib import Path
from typing import IO, Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError, counted
from rlco.files import few, reading, shown
from rlco.files.fields import is_number
from rlco.files.sizes import check_declared
from rlco.files.texts import parse_json, read_text
from rlco.gap.logs.formats.columns import tables_of
from rlco.gap.logs.formats.headers import POSE, parse_header
from rlco.gap.logs.log import Array
from rlco.gap.logs.table import Table
from rlco.gap.model import LoadedModel

#: Arrays that name the columns of others.
_NAMES = ("columns", "header", "names", "joint_names", "joints")
_LENGTHS = ("length", "lengths", "episode_lengths")
_MOTION = ("vx", "vy", "vz", "wx", "wy", "wz")
_WHOLE = "data"
#: Kinds of arrays that are read: numbers, flags and texts.
_READ = "fiubUS"
_npy: Any = np.lib.format  # which has no types

Counts = NDArray[np.int64]


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
    lengths = _lengths(path, arrays)
    facts, notes = _facts(path, arrays)
    tables = {k: a for k, a in arrays.items() if a.ndim in (1, 2)}
    rows = _rows(path, tables, lengths)
    columns: dict[str, Array] = {}
    for key, array in tables.items():
        if len(array) == rows and array.dtype.kind in "fiub":
            columns |= _columns(path, key, array.astype(float), names, model)
    period = facts.get("dt", 1.0 / facts["fps"] if facts.get("fps") else None)
    counts = None if lengths is None else lengths.tolist()
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


#: Bytes of an array's header, as many as numpy's own limit.
_HEADER = 10_000


def _arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    """Return the arrays that may be columns, facts or names; no others are read."""
    advice = "save plain arrays with numpy.savez"
    found: dict[str, NDArray[np.generic]] = {}
    with reading(path, tokenize.TokenError, advice=advice), ZipFile(path) as archive:
        declared = {}
        for entry in archive.infolist():
            name = entry.filename.removesuffix(".npy")
            if name == entry.filename:
                continue
            with archive.open(entry) as stream:
                shape, dtype = _header(stream)
            if dtype.hasobject:
                raise DataError(
                    f"array {name!r} of {str(path)!r} holds Python objects, which may "
                    f"run code and are not read; {advice}."
                )
            if dtype.kind in _READ and len(shape) <= 2:
                declared[name] = entry, math.prod(shape) * dtype.itemsize
        check_declared(path, sum(size for _, size in declared.values()))
        for name, (entry, _) in declared.items():
            with archive.open(entry) as stream:
                found[name] = _npy.read_array(stream, allow_pickle=False)
    return found


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return what an array declares of itself.

    Raises:
        ValueError: It does so in more words than numpy reads, which numpy says once it
            has taken the memory for them.
    """
    version = _npy.read_magic(stream)
    first = version == (1, 0)
    size = stream.read(2 if first else 4)
    length = int.from_bytes(size, "little")
    if length > _HEADER:
        raise ValueError(f"a header of {length} bytes, of at most {_HEADER}")
    header = io.BytesIO(size + stream.read(length))
    read = _npy.read_array_header_1_0 if first else _npy.read_array_header_2_0
    shape, _, dtype = read(header)
    return shape, dtype


def _lengths(path: Path, arrays: dict[str, NDArray[np.generic]]) -> Counts | None:
    """Return the rows of each recording, where an array gives them."""
    given = next((arrays[key] for key in _LENGTHS if key in arrays), None)
    if given is None:
        return None
    numbers = given.ndim == 1 and given.size and given.dtype.kind in "iuf"
    rows = given.astype(float) if numbers else np.zeros(1)
    # More rows than a float counts exactly are none of a recording.
    if not np.all((rows >= 1) & (rows == np.floor(rows)) & (rows < 2**53)):
        raise DataError(
            f"the lengths in {str(path)!r} are {shown(given.tolist())}; give the rows "
            "of each recording, whole numbers above 0, or leave them out."
        )
    return rows.astype(np.int64)


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
    content = parse_json(read_text(beside), beside)
    numbers = {
        key: float(value)
        for key, value in (content.items() if isinstance(content, dict) else ())
        if is_number(value)
    }
    note = f"Facts were read from {beside.name}: {few(list(numbers))}."
    return {**numbers, **facts}, [note] if numbers else []


def _rows(
    path: Path,
    tables: dict[str, NDArray[np.generic]],
    lengths: Counts | None,
) -> int:
    if lengths is not None:
        return sum(lengths.tolist())
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
                f"array {key!r} of {str(path)!r} has {counted(count, 'column')} "
                "without names; save their names as an array 'columns'."
            )
        return {name: array[:, i] for i, name in enumerate(named)}
    if parse_header(key).kind != "extra" and count == 1:
        return {key: array[:, 0]}
    whose = names if names and len(names) == count else [str(i) for i in range(count)]
    return {f"{key}.{name}": array[:, i] for i, name in enumerate(whose)}
