"""The description of a LeRobot folder, as plain frozen data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rlco.errors import DataError, suggest
from rlco.files import few


@dataclass(frozen=True)
class Feature:
    """One column of a data set.

    Attributes:
        stored_name: Its name in the files, before any renaming.
        dtype: LeRobot's type name: ``float32``, ``int64``, ``image``, ``video``, ...
        shape: Shape of one frame's value.
        names: Name of each dimension, or None where the data set gives none.
    """

    stored_name: str
    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] | None = None

    @property
    def size(self) -> int:
        """Number of values per frame."""
        return math.prod(self.shape)

    @property
    def is_camera(self) -> bool:
        """Whether the feature is an image, stored as PNG or as video."""
        return self.dtype in ("image", "video")


@dataclass(frozen=True)
class VideoSpan:
    """Location of an episode's images: a file and its first frame's time [s]."""

    file: Path
    start: float


@dataclass(frozen=True)
class Episode:
    """One recorded episode: its index, its number of frames, its files.

    ``videos`` is keyed by the stored name of the camera.
    """

    index: int
    length: int
    data_file: Path
    videos: Mapping[str, VideoSpan]


@dataclass(frozen=True)
class LeRobotFolder:
    """A LeRobot data set on disk, its metadata read and checked.

    Attributes:
        path: The folder.
        version: ``"v2.1"`` or ``"v3.x"``.
        fps: Frame rate [1/s].
        robot_type: The recorder's name of the robot, if it gave one.
        features: By name, after renaming.
        tasks: Task text by task index.
        episodes: Those selected, in the order requested.
        renamed: ``{"their.name": "our.name"}``, as asked for.
        recorded: How rlco recorded it, by `RECORDED`; empty where another program did.
    """

    path: Path
    version: str
    fps: float
    robot_type: str | None
    features: Mapping[str, Feature]
    tasks: Mapping[int, str]
    episodes: tuple[Episode, ...]
    renamed: Mapping[str, str] = field(default_factory=dict)
    recorded: Mapping[str, Any] = field(default_factory=dict)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the features that are images."""
        return tuple(name for name, f in self.features.items() if f.is_camera)

    def feature(self, name: str) -> Feature:
        """Return one feature.

        Raises:
            DataError: If there is no such feature; lists the existing ones and suggests
                ``rename=``.
        """
        if name in self.renamed and name not in self.features:
            raise DataError(
                f"data set {str(self.path)!r} has no feature {name!r} any more: rename "
                f"gave it the name {self.renamed[name]!r}; leave that out, since rlco "
                "reads it under its own name."
            )
        if name not in self.features:
            raise DataError(
                f"data set {str(self.path)!r} has no feature {name!r}"
                f"{suggest(name, self.features)}; it has "
                f"{few(list(self.features), 30)}; "
                f'where one of them is meant, give rename={{"its name": "{name}"}}, '
                f"in a recipe rename=ITS_NAME:{name}."
            )
        return self.features[name]
