"""Read the images of a LeRobot folder: PNG in the parquet files, or video."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
import PIL.Image

from rlco.errors import DataError
from rlco.files.places import inside
from rlco.lerobot_files.columns import (
    episode_rows,
    read_columns,
    read_stored_columns,
)
from rlco.lerobot_files.schema import Episode, Feature, LeRobotFolder, VideoSpan

Images = npt.NDArray[np.uint8]

#: What is decoded: formats of images, of films, and how films are coded. The decoders
#: of all others, some of them decades old, never see a byte of a data set.
_IMAGES = ("PNG", "JPEG")
_FILMS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi"
_CODECS = ("h264", "hevc", "av1", "dav1d", "aom", "mpeg4", "vp8", "vp9", "vpx", "mjpeg")
#: Twice an 8K film's. [pixels]
_MOST_PIXELS = 2**26


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
            table = read_stored_columns(
                inside(folder.path, file), [feature.stored_name]
            )
            column = table[feature.stored_name]
        rows = episode_rows(file, table, [episode])[episode.index]
        frames = [
            _decode_png(episode, t, feature, column[int(row)].as_py())
            for t, row in enumerate(rows)
        ]
        yield _stack(episode, frames)


def _decode_png(episode: Episode, frame: int, feature: Feature, cell: Any) -> Images:
    content = cell.get("bytes") if isinstance(cell, dict) else None
    where = (
        f"the image of frame {frame} of episode {episode.index} in file "
        f"{str(episode.data_file)!r}"
    )
    if not isinstance(content, bytes):
        raise DataError(f"{where} is not in the file; embed the images in it.")
    try:
        with PIL.Image.open(io.BytesIO(content), formats=_IMAGES) as image:
            _check_size(feature, image.size, where)
            return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, PIL.Image.DecompressionBombError) as bad:
        if isinstance(bad, DataError):
            raise
        raise DataError(f"{where} is damaged ({bad}); copy it again.") from None


def _check_size(feature: Feature, size: tuple[int, int], where: str) -> None:
    """Check width and height [pixels] before anything of that size is decoded."""
    # Whether height or width is listed first differs from recorder to recorder.
    if not Counter(size) <= Counter(feature.shape):
        raise DataError(
            f"{where} is {size[0]} pixels wide and {size[1]} high, but meta/info.json "
            f"gives its shape as {list(feature.shape)}; copy the data set again."
        )
    if size[0] * size[1] > _MOST_PIXELS:
        raise DataError(
            f"{where} has {size[0] * size[1]} pixels, and at most {_MOST_PIXELS} are "
            "read; scale the images down."
        )


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
        inside(folder.path, span.file)
        frames = _decode_video(feature, span, span.start + times, 0.5 / folder.fps)
        if len(frames) < episode.length:
            raise DataError(
                f"video file {str(span.file)!r} has no image for frame {len(frames)} "
                f"of episode {episode.index}, at {span.start + times[len(frames)]:.3f} "
                "s; copy it again, or leave the episode out."
            )
        yield _stack(episode, frames)


def _decode_video(
    feature: Feature,
    span: VideoSpan,
    times: npt.NDArray[np.float64],
    tolerance: float,
) -> list[Images]:
    """Return the frames at ``times`` [s], up to the first one not found."""
    frames: list[Images] = []
    where = f"video file {str(span.file)!r}"
    try:
        # A list of other files, which some formats are, is none of them.
        with av.open(str(span.file), options={"format_whitelist": _FILMS}) as container:
            stream = container.streams.video[0]
            _check_codec(stream, where)
            _check_size(feature, (stream.width, stream.height), where)
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
                    _check_size(feature, (frame.width, frame.height), where)
                    frames.append(frame.to_ndarray(format="rgb24").astype(np.uint8))
    except (av.FFmpegError, IndexError, OverflowError, UnicodeError) as error:
        raise DataError(
            f"{where} cannot be decoded ({error}); copy it again."
        ) from None
    return frames


def _check_codec(stream: av.VideoStream, where: str) -> None:
    if stream.codec_context is None:
        raise DataError(f"{where} cannot be decoded (no known codec); copy it again.")
    name = stream.codec_context.name
    if not name.removeprefix("lib").startswith(_CODECS):
        raise DataError(
            f"{where} is coded as {name!r}, and {', '.join(_CODECS)} are read; encode "
            "it as one of them."
        )


def _stack(episode: Episode, frames: list[Images]) -> Images:
    sizes = {frame.shape for frame in frames}
    if len(sizes) > 1:
        raise DataError(
            f"the images of episode {episode.index} differ in size: {sorted(sizes)}."
        )
    return np.ascontiguousarray(np.stack(frames).transpose(0, 3, 1, 2))
