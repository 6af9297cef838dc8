"""Read the images of a LeRobot folder: PNG in the parquet files, or video."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
import PIL.Image

from rlco.errors import DataError
from rlco.lerobot_files.columns import (
    episode_rows,
    read_columns,
    read_stored_columns,
)
from rlco.lerobot_files.schema import Episode, Feature, LeRobotFolder, VideoSpan

Images = npt.NDArray[np.uint8]


def iterate_images(folder: LeRobotFolder, name: str) -> Iterator[Images]:
    """Decode one camera, one episode at a time, in the order of the episodes.

    Only one episode's images are in memory at once, besides the compressed ones of one
    file.

    Args:
        folder: Result of ``read_folder``.
        name: The camera, by its name after renaming.

    Yields:
        Shape (frames, 3, height, width), RGB.

    Raises:
        DataError: If the feature is not a camera, or an image is missing or damaged.
    """
    feature = folder.feature(name)
    if feature.dtype == "image":
        return _iterate_png(folder, feature)
    if feature.dtype == "video":
        return _iterate_video(folder, feature)
    raise DataError(
        f"feature {name!r} of data set {str(folder.path)!r} is not a camera; cameras: "
        f"{', '.join(folder.cameras) or 'none'}."
    )


def _iterate_png(folder: LeRobotFolder, feature: Feature) -> Iterator[Images]:
    file: Path | None = None
    for episode in folder.episodes:
        if episode.data_file != file:
            file = episode.data_file
            table = read_stored_columns(file, [feature.stored_name])
            column = table[feature.stored_name]
        rows = episode_rows(file, table, [episode])[episode.index]
        frames = [
            _decode_png(episode, t, column[int(row)].as_py())
            for t, row in enumerate(rows)
        ]
        yield _stack(episode, frames)


def _decode_png(episode: Episode, frame: int, cell: Any) -> Images:
    content = cell.get("bytes") if isinstance(cell, dict) else None
    where = (
        f"the image of frame {frame} of episode {episode.index} in file "
        f"{str(episode.data_file)!r}"
    )
    if not isinstance(content, bytes):
        raise DataError(f"{where} is not in the file; embed the images in it.")
    try:
        with PIL.Image.open(io.BytesIO(content)) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError) as error:
        raise DataError(f"{where} is damaged ({error}); copy it again.") from None


def _iterate_video(folder: LeRobotFolder, feature: Feature) -> Iterator[Images]:
    spans = [episode.videos[feature.stored_name] for episode in folder.episodes]
    for episode, span in zip(folder.episodes, spans, strict=True):
        if not span.file.is_file():
            raise DataError(
                f"video file {str(span.file)!r} of episode {episode.index} is missing; "
                "copy it, or leave the images out (load_demos: image_key=False)."
            )
    timestamps = np.split(
        np.asarray(read_columns(folder, ["timestamp"])["timestamp"], np.float64),
        np.cumsum([episode.length for episode in folder.episodes])[:-1],
    )
    for episode, span, times in zip(folder.episodes, spans, timestamps, strict=True):
        frames = _decode_video(span, span.start + times, 0.5 / folder.fps)
        if len(frames) < episode.length:
            raise DataError(
                f"video file {str(span.file)!r} has no image for frame {len(frames)} "
                f"of episode {episode.index}, at {span.start + times[len(frames)]:.3f} "
                "s; copy it again, or leave the episode out."
            )
        yield _stack(episode, frames)


def _decode_video(
    span: VideoSpan, times: npt.NDArray[np.float64], tolerance: float
) -> list[Images]:
    """Return the frames at ``times`` [s], up to the first one not found."""
    frames: list[Images] = []
    try:
        with av.open(str(span.file)) as container:
            stream = container.streams.video[0]
            if stream.time_base is not None:
                # Seek to the key frame at or before the first time, then skip.
                container.seek(int(times[0] / stream.time_base), stream=stream)
            for frame in container.decode(stream):
                if len(frames) == len(times) or frame.time is None:
                    break
                ahead = frame.time - times[len(frames)]
                if ahead > tolerance:
                    break
                if ahead >= -tolerance:
                    frames.append(frame.to_ndarray(format="rgb24").astype(np.uint8))
    except (av.FFmpegError, IndexError) as error:
        raise DataError(
            f"video file {str(span.file)!r} cannot be decoded ({error}); copy it again."
        ) from None
    return frames


def _stack(episode: Episode, frames: list[Images]) -> Images:
    sizes = {frame.shape for frame in frames}
    if len(sizes) > 1:
        raise DataError(
            f"the images of episode {episode.index} differ in size: {sorted(sizes)}."
        )
    return np.ascontiguousarray(np.stack(frames).transpose(0, 3, 1, 2))
