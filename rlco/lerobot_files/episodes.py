"""The lists of tasks and episodes, which v2.1 and v3 store differently."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, Literal, NoReturn

from rlco.errors import DataError
from rlco.files import Fields, few, read_json_lines, shown
from rlco.files.indices import format_indices
from rlco.files.places import filled, inside
from rlco.lerobot_files.schema import Episode, VideoSpan
from rlco.lerobot_files.tables import (
    has_footer,
    read_table,
    real_numbers,
    whole_numbers,
)

_DATA_V2 = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
_VIDEO_V2 = (
    "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
)
_DATA_V3 = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO_V3 = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"


def tasks_v2(path: Path) -> dict[int, str]:
    """Return the task texts of a v2.1 folder by their index."""
    rows = read_json_lines(inside(path, path / "meta" / "tasks.jsonl"))
    return {row.integer("task_index"): row.text("task") for row in rows}


def tasks_v3(path: Path) -> dict[int, str]:
    """Return the task texts of a v3 folder by their index."""
    file = inside(path, path / "meta" / "tasks.parquet")
    table = read_table(file)
    # pandas stores the text as the index, whose column name depends on the writer.
    texts = [
        name for name in ("task", "__index_level_0__") if name in table.schema.names
    ]
    if not texts or "task_index" not in table.schema.names:
        raise DataError(f"file {str(file)!r} has no columns task and task_index.")
    indices = whole_numbers(file, table, "task_index").tolist()
    tasks = table[texts[0]].to_pylist()
    return {index: str(task) for index, task in zip(indices, tasks, strict=True)}


def episodes_v2(path: Path, info: Fields, videos: Sequence[str]) -> list[Episode]:
    """List the episodes of a v2.1 folder: one data file and one video each."""
    data_path = info.text("data_path", None) or _DATA_V2
    video_path = info.text("video_path", None) or _VIDEO_V2
    chunk_size = info.integer("chunks_size", 1000, minimum=1)
    listed = []
    for row in read_json_lines(inside(path, path / "meta" / "episodes.jsonl")):
        index = row.integer("episode_index", minimum=0)
        where = {"episode_index": index, "episode_chunk": index // chunk_size}
        spans = {
            key: VideoSpan(
                _file(path, "video_path", video_path, video_key=key, **where), 0.0
            )
            for key in videos
        }
        length = row.integer("length", minimum=0)
        data_file = _file(path, "data_path", data_path, **where)
        listed.append(Episode(index, length, data_file, spans))
    return listed


def episodes_v3(path: Path, info: Fields, videos: Sequence[str]) -> list[Episode]:
    """List the episodes of a v3 folder, many of which share a file.

    Raises:
        DataError: If the recording was never finished, or a table is damaged.
    """
    total = info.integer("total_episodes", 0, minimum=0)
    files = sorted((path / "meta" / "episodes").rglob("*.parquet"))
    data_files = sorted((path / "data").rglob("*.parquet"))
    # LeRobot writes the footers of its last table and of its last data file at the very
    # end: both are missing together only where finalize() did not run.
    if (
        total
        and not (files and has_footer(files[-1]))
        and not (data_files and has_footer(data_files[-1]))
    ):
        raise_unfinished(path, "LeRobot's finalize() was never called")
    listed = [
        episode for file in files for episode in _table_v3(path, file, info, videos)
    ]
    if len(listed) < total:
        raise_unfinished(path, f"{len(listed)} of {total} episodes were written out")
    return listed


def _table_v3(
    path: Path, file: Path, info: Fields, videos: Sequence[str]
) -> Iterator[Episode]:
    """Give the episodes that one table lists."""
    prefixes = ["data", *(f"videos/{key}" for key in videos)]
    starts = [f"videos/{key}/from_timestamp" for key in videos]
    counts = ["episode_index", "length", *chain(*map(_location_columns, prefixes))]
    table = read_table(inside(path, file), [*counts, *starts])
    lacking = [name for name in (*counts, *starts) if name not in table.schema.names]
    if lacking and table.num_rows:
        raise DataError(
            f"the episode table of data set {str(path)!r} has no column {few(lacking)}."
        )
    if not table.num_rows:
        return
    columns: dict[str, list[Any]] = {
        name: whole_numbers(file, table, name).tolist() for name in counts
    }
    columns |= {name: real_numbers(file, table, name).tolist() for name in starts}
    data_path = info.text("data_path", None) or _DATA_V3
    video_path = info.text("video_path", None) or _VIDEO_V3

    @cache  # many episodes share a file
    def place(prefix: str, chunk: int, number: int) -> Path:
        where = {"chunk_index": chunk, "file_index": number}
        if prefix == "data":
            return _file(path, "data_path", data_path, **where)
        key = prefix.removeprefix("videos/")
        return _file(path, "video_path", video_path, video_key=key, **where)

    for row in range(table.num_rows):
        data, *films = [
            place(prefix, *(columns[name][row] for name in _location_columns(prefix)))
            for prefix in prefixes
        ]
        spans = {
            key: VideoSpan(film, columns[start][row])
            for key, film, start in zip(videos, films, starts, strict=True)
        }
        index, length = columns["episode_index"][row], columns["length"][row]
        yield Episode(index, length, data, spans)


def _file(path: Path, option: str, template: str, **where: str | int) -> Path:
    """Return the file that a path of meta/info.json names; it stays in the folder.

    Links are followed when it is read.
    """
    text = filled(template, where, option, given=str(path))
    if ".." in Path(text).parts or Path(text).is_absolute() or "\0" in text:
        raise DataError(
            f"{option} of data set {str(path)!r} leads out of it, to {shown(text)}; "
            "give a path inside."
        )
    return path / text


def _location_columns(prefix: str) -> tuple[str, str]:
    return f"{prefix}/chunk_index", f"{prefix}/file_index"


def raise_unfinished(path: Path, reason: str) -> NoReturn:
    """Raise the error for a recording that was never finished."""
    raise DataError(
        f"data set {str(path)!r} is an unfinished recording ({reason}); record it "
        "again, or remove it."
    )


def select(
    path: Path,
    listed: Sequence[Episode],
    wanted: Iterable[int] | Literal["present"] | None,
) -> tuple[Episode, ...]:
    """Return the requested episodes, in the order requested; None requests all.

    ``present`` requests those whose file exists.

    Raises:
        DataError: If an index is unknown or repeated, or an episode's file is missing;
            the message lists those that exist.
    """
    by_index = {episode.index: episode for episode in listed}
    if wanted == "present":
        there = [episode.index for episode in listed if episode.data_file.is_file()]
        wanted = there or None
    indices = list(by_index if wanted is None else wanted)
    unknown = [index for index in indices if index not in by_index]
    twice = {index for index, count in Counter(indices).items() if count > 1}
    if unknown or not indices or twice:
        culprit = "asks for none"
        if unknown:
            culprit = f"asks for {format_indices(set(unknown))}, which it does not have"
        elif twice:
            culprit = f"asks for {format_indices(twice)} more than once"
        raise DataError(
            f"episodes={format_indices(indices)} of data set {str(path)!r} {culprit}; "
            f"give different indices, at least one, out of {format_indices(by_index)}."
        )
    present = {episode.index for episode in listed if episode.data_file.is_file()}
    missing = [index for index in indices if index not in present]
    if missing:
        read_others = (
            f", or read those that are there with episodes= out of "
            f"{format_indices(present)}"
        )
        raise DataError(
            f"data set {str(path)!r} lists episodes {format_indices(missing)}, whose "
            f"files are missing (the first is {by_index[missing[0]].data_file.name}); "
            f"copy them{read_others if present else ''}."
        )
    return tuple(by_index[index] for index in indices)
