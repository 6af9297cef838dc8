"""The lists of tasks and episodes, which v2.1 and v3 store differently."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, NoReturn

from rlco.errors import DataError
from rlco.lerobot_files.schema import Episode, VideoSpan
from rlco.lerobot_files.tables import has_footer, read_jsonl, read_table
from rlco.runs.indices import format_indices

_DATA_V2 = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
_VIDEO_V2 = (
    "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
)
_DATA_V3 = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO_V3 = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"


def tasks_v2(path: Path) -> dict[int, str]:
    """Return the task texts of a v2.1 folder by their index."""
    file = path / "meta" / "tasks.jsonl"
    try:
        return {int(row["task_index"]): str(row["task"]) for row in read_jsonl(file)}
    except KeyError as error:
        raise DataError(f"a line of file {str(file)!r} lacks {error}.") from None


def tasks_v3(path: Path) -> dict[int, str]:
    """Return the task texts of a v3 folder by their index."""
    file = path / "meta" / "tasks.parquet"
    table = read_table(file).to_pydict()
    # pandas stores the text as the index, whose column name depends on the writer.
    texts = table.get("task", table.get("__index_level_0__"))
    if texts is None or "task_index" not in table:
        raise DataError(f"file {str(file)!r} has no columns task and task_index.")
    return {int(i): str(t) for i, t in zip(table["task_index"], texts, strict=True)}


def episodes_v2(
    path: Path, info: dict[str, Any], videos: Sequence[str]
) -> list[Episode]:
    """List the episodes of a v2.1 folder: one data file and one video each."""
    data_path = str(info.get("data_path") or _DATA_V2)
    video_path = str(info.get("video_path") or _VIDEO_V2)
    chunk_size = int(info.get("chunks_size") or 1000)
    file = path / "meta" / "episodes.jsonl"
    listed = []
    for row in read_jsonl(file):
        if "episode_index" not in row or "length" not in row:
            raise DataError(
                f"a line of file {str(file)!r} lacks episode_index or length."
            )
        index = int(row["episode_index"])
        where = {"episode_index": index, "episode_chunk": index // chunk_size}
        spans = {
            key: VideoSpan(path / video_path.format(video_key=key, **where), 0.0)
            for key in videos
        }
        data_file = path / data_path.format(**where)
        listed.append(Episode(index, int(row["length"]), data_file, spans))
    return listed


def episodes_v3(
    path: Path, info: dict[str, Any], videos: Sequence[str]
) -> list[Episode]:
    """List the episodes of a v3 folder, many of which share a file.

    Raises:
        DataError: If the recording was never finished, or a table is damaged.
    """
    total = int(info.get("total_episodes") or 0)
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
    columns = ["episode_index", "length", *_location_columns("data")]
    for key in videos:
        columns += [*_location_columns(f"videos/{key}"), f"videos/{key}/from_timestamp"]
    rows = [row for file in files for row in read_table(file, columns).to_pylist()]
    if len(rows) < total:
        raise_unfinished(path, f"{len(rows)} of {total} episodes were written out")
    lacking = [name for name in columns if rows and name not in rows[0]]
    if lacking:
        raise DataError(
            f"the episode table of data set {str(path)!r} has no column "
            f"{', '.join(lacking)}."
        )
    data_path = str(info.get("data_path") or _DATA_V3)
    video_path = str(info.get("video_path") or _VIDEO_V3)
    listed = []
    for row in rows:
        spans = {
            key: VideoSpan(
                path / _locate(row, f"videos/{key}", video_path, video_key=key),
                float(row[f"videos/{key}/from_timestamp"]),
            )
            for key in videos
        }
        data_file = path / _locate(row, "data", data_path)
        listed.append(
            Episode(int(row["episode_index"]), int(row["length"]), data_file, spans)
        )
    return listed


def _location_columns(prefix: str) -> tuple[str, str]:
    return f"{prefix}/chunk_index", f"{prefix}/file_index"


def _locate(row: dict[str, Any], prefix: str, template: str, **key: str) -> str:
    chunk, file = _location_columns(prefix)
    return template.format(chunk_index=row[chunk], file_index=row[file], **key)


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
