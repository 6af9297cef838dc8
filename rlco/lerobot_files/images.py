"""Read the images of a LeRobot folder: PNG in the parquet files, or video."""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt
import PIL.Image

from rlco.errors import DataError
from rlco.files import few
from rlco.files.places import inside
from rlco.files.sizes import check_held
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
        DataError: If the feature is not a camera, an image is missing or damaged, or an
            episode's images take more than half of the memory.
    """
    feature = folder.feature(name)
    if feature.dtype == "image":
        return _iterate_png(folder, feature)
    if feature.dtype == "video":
        return _iterate_video(folder, feature)
    raise DataError(
        f"feature {name!r} of data set {str(folder.path)!r} is not a camera; cameras: "
        f"{few(folder.cameras) or 'none'}."
    )


class _Film:
    """An episode's images, each of which is written where it stays.

    No second one is decoded before it is known that there is memory for all: a
    image of one colour takes a few bytes in a file, and an episode may be any number
    of times the same.
    """

    def __init__(self, episode: Episode) -> None:
        self.episode = episode
        self.images: Images = np.empty((0, 3, 0, 0), np.uint8)
        self.written = 0

    def make_room(self, size: tuple[int, int]) -> None:
        """Take memory for images of a width and height [pixels]; call before each.

        Raises:
            DataError: They are more than memory is for, or one differs in size.
        """
        width, height = size
        if self.written:
            if self.images.shape[2:] != (height, width):
                raise DataError(
                    f"the images of episode {self.episode.index} differ in size: "
                    f"{self.images.shape[2:]} and {(height, width)} (height, width)."
                )
            return
        shape = (self.episode.length, 3, height, width)
        check_held(
            math.prod(shape),
            f"the {shape[0]} images of episode {self.episode.index}, {width} pixels "
            f"wide and {height} high,",
            "leave the episode out with episodes=, or record it in parts or in smaller "
            "images",
        )
        self.images = np.empty(shape, np.uint8)

    def add(self, image: Images) -> None:
        """Write the next image, (height, width, 3)."""
        self.images[self.written] = image.transpose(2, 0, 1)
        self.written += 1


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
        film = _Film(episode)
        for t, row in enumerate(rows):
            _decode_png(film, t, feature, column[int(row)].as_py())
        yield film.images


def _decode_png(film: _Film, frame: int, feature: Feature, cell: Any) -> None:
    content = cell.get("bytes") if isinstance(cell, dict) else None
    where = (
        f"the image of frame {frame} of episode {film.episode.index} in file "
        f"{str(film.episode.data_file)!r}"
    )
    if not isinstance(content, bytes):
        raise DataError(f"{where} is not in the file; embed the images in it.")
    try:
        with PIL.Image.open(io.BytesIO(content), formats=_IMAGES) as image:
            _check_size(feature, image.size, where)
            film.make_room(image.size)
            film.add(np.asarray(image.convert("RGB")))
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
        film = _Film(episode)
        _decode_video(film, feature, span, span.start + times, 0.5 / folder.fps)
        found = film.written
        if found < episode.length:
            raise DataError(
                f"video file {str(span.file)!r} has no image for frame {found} "
                f"of episode {episode.index}, at {span.start + times[found]:.3f} "
                "s; copy it again, or leave the episode out."
            )
        yield film.images


def _decode_video(
    film: _Film,
    feature: Feature,
    span: VideoSpan,
    times: npt.NDArray[np.float64],
    tolerance: float,
) -> None:
    """Add the frames at ``times`` [s] to a film, up to the first one not found."""
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
                if film.written == len(times) or frame.time is None:
                    break
                ahead = frame.time - times[film.written]
                if ahead > tolerance:
                    break
                if ahead >= -tolerance:
                    _check_size(feature, (frame.width, frame.height), where)
                    film.make_room((frame.width, frame.height))
                    image = frame.to_ndarray(format="rgb24")
                    film.add(image.astype(np.uint8, copy=False))
    except (av.FFmpegError, IndexError, OverflowError, UnicodeError) as error:
        raise DataError(
            f"{where} cannot be decoded ({error}); copy it again."
        ) from None


def _check_codec(stream: av.VideoStream, where: str) -> None:
    if stream.codec_context is None:
        raise DataError(f"{where} cannot be decoded (no known codec); copy it again.")
    name = stream.codec_context.name
    if not name.removeprefix("lib").startswith(_CODECS):
        raise DataError(
            f"{where} is coded as {name!r}, and {', '.join(_CODECS)} are read; encode "
            "it as one of them."
        )
