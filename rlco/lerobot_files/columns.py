"""Read the numeric features of a LeRobot folder, each parquet file once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from rlco.errors import DataError
from rlco.files import few, reading, shown
from rlco.files.places import inside
from rlco.files.reading import cut
from rlco.lerobot_files.parquet_footer import leaves
from rlco.lerobot_files.schema import Episode, Feature, LeRobotFolder
from rlco.lerobot_files.tables import read_table, whole_numbers

Array = npt.NDArray[np.generic]


#: The largest magnitude that can be trained on: squares of float32 end at ten times it.
LARGEST = 1e18


def check_stored_sizes(folder: LeRobotFolder, names: Iterable[str]) -> None:
    """Check that the folder's first file has all numbers that features are to have.

    What is said in meta/info.json may be any number, and who counts on it, such as a
    network of that size, takes memory before the rows are read.

    Args:
        folder: Result of ``read_folder``.
        names: Numeric features, by their names after renaming.

    Raises:
        DataError: A feature is missing, or has fewer numbers a frame, or the file is
            damaged.
    """
    file = inside(folder.path, folder.episodes[0].data_file)
    with reading(file):
        stored = list(leaves(file))
    for feature in map(folder.feature, names):
        parts = [leaf for leaf in stored if leaf.column == feature.stored_name]
        rows, values = sum(p.rows for p in parts), sum(p.values for p in parts)
        if parts and rows * feature.size > values:
            raise _other_size(file, feature, values, rows)


def read_columns(
    folder: LeRobotFolder, names: Iterable[str], *, largest: float = math.inf
) -> dict[str, Array]:
    """Read numeric features of all the folder's episodes, one after the other.

    Args:
        folder: Result of ``read_folder``.
        names: Features, by their names after renaming.
        largest: Magnitude that a number may have at most.

    Returns:
        One array per name: shape (frames, *feature shape), without the last axis
        where the feature is a single number, in the data set's dtype and units.

    Raises:
        DataError: If a feature is missing or not numeric, a file is damaged, a value is
            missing, NaN, infinite or too large, or the frames are not those listed.
    """
    features = {name: folder.feature(name) for name in names}
    for name, feature in features.items():
        if feature.is_camera or feature.dtype in ("string", "language"):
            raise DataError(
                f"feature {name!r} of data set {str(folder.path)!r} is of type "
                f"{shown(feature.dtype)} and holds no numbers."
            )
    by_file: dict[Path, list[Episode]] = {}
    for episode in folder.episodes:
        by_file.setdefault(episode.data_file, []).append(episode)
    parts: dict[int, dict[str, Array]] = {}
    for file, episodes in by_file.items():
        parts |= _read_file(inside(folder.path, file), episodes, features)
    columns = {
        name: np.concatenate(
            [parts[episode.index][name] for episode in folder.episodes]
        )
        for name in features
    }
    for name, column in columns.items():
        _check_finite(folder, name, column, largest)
    return columns


def _read_file(
    file: Path, episodes: Sequence[Episode], features: dict[str, Feature]
) -> dict[int, dict[str, Array]]:
    table = read_stored_columns(file, [f.stored_name for f in features.values()])
    arrays = {
        name: _to_array(file, table[feature.stored_name], feature)
        for name, feature in features.items()
    }
    rows = episode_rows(file, table, episodes)
    return {
        index: {name: array[where] for name, array in arrays.items()}
        for index, where in rows.items()
    }


def read_stored_columns(file: Path, stored_names: Sequence[str]) -> pa.Table:
    """Read columns by their names in the file, and those that index frames.

    Raises:
        DataError: If the file is damaged or lacks a column.
    """
    asked = list(dict.fromkeys([*stored_names, "episode_index", "frame_index"]))
    table = read_table(file, asked)
    lacking = [name for name in asked if name not in table.column_names]
    if lacking:
        raise DataError(f"file {str(file)!r} has no column {few(lacking)}.")
    return table


def episode_rows(
    file: Path, table: pa.Table, episodes: Sequence[Episode]
) -> dict[int, npt.NDArray[np.int64]]:
    """Return each episode's rows of a table, in the order of its frames.

    Raises:
        DataError: If an episode has other frames than its metadata lists.
    """
    episode = whole_numbers(file, table, "episode_index")
    frame = whole_numbers(file, table, "frame_index")
    order = np.lexsort((frame, episode))
    ordered = episode[order]
    rows = {}
    for entry in episodes:
        start, stop = np.searchsorted(ordered, [entry.index, entry.index + 1])
        where = order[start:stop]
        # The length first: it is a number in a file, and may be any.
        as_listed = len(where) == entry.length
        if not (as_listed and np.array_equal(frame[where], np.arange(entry.length))):
            raise DataError(
                f"episode {entry.index} in file {str(file)!r} holds {len(where)} "
                f"frames, not exactly the frames 0 to {entry.length - 1} that the "
                "metadata list; copy the data set again, or leave the episode out."
            )
        rows[entry.index] = where
    return rows


def _to_array(file: Path, column: pa.ChunkedArray, feature: Feature) -> Array:
    values = column.combine_chunks()
    rows = len(values)
    nulls = int(values.null_count)
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        values = values.flatten()
        nulls += int(values.null_count)
    name = feature.stored_name
    if nulls:
        raise DataError(f"column {name!r} of file {str(file)!r} has missing values.")
    with reading(file, pa.ArrowException):
        flat = np.asarray(values.to_numpy(zero_copy_only=False))
    if flat.dtype.kind not in "fiub":
        raise DataError(
            f"column {name!r} of file {str(file)!r} holds {cut(str(values.type))}, "
            "not numbers."
        )
    if flat.size != rows * feature.size:
        raise _other_size(file, feature, flat.size, rows)
    return flat.reshape(rows, *(() if feature.shape == (1,) else feature.shape))


def _other_size(file: Path, feature: Feature, found: int, rows: int) -> DataError:
    return DataError(
        f"column {feature.stored_name!r} of file {str(file)!r} holds "
        f"{found / max(rows, 1):g} numbers per frame, but meta/info.json says "
        f"{feature.size}; correct its shape there, or copy the data set again."
    )


def _check_finite(
    folder: LeRobotFolder, name: str, column: Array, largest: float
) -> None:
    if column.dtype.kind == "b":
        return
    flat = column.reshape(len(column), math.prod(column.shape[1:]))
    broken = ~np.isfinite(flat)
    if math.isfinite(largest):
        broken |= np.abs(flat.astype(np.float64)) > largest
    bad = broken.any(axis=1)
    if not bad.any():
        return
    row = int(bad.argmax())
    finite = bool(np.isfinite(flat).all())
    what = f"beyond +-{largest:g}" if finite else "NaN or infinite"
    names = folder.feature(name).names
    number = f" ({names[int(broken[row].argmax())]})" if names else ""
    ends = np.cumsum([episode.length for episode in folder.episodes])
    which = int(np.searchsorted(ends, row, side="right"))
    episode = folder.episodes[which]
    raise DataError(
        f"feature {name!r}{number} of data set {str(folder.path)!r} is {what} "
        f"in {int(bad.sum())} of {len(column)} frames, first in episode "
        f"{episode.index} at frame {row - int(ends[which]) + episode.length}; correct "
        "it, or leave the episode out with episodes=."
    )
