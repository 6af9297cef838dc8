"""The metadata of a LeRobot folder: read, checked, and unified across versions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from rlco.errors import DataError, suggest
from rlco.files import Fields, few, read_json, reading, shown
from rlco.files.places import inside
from rlco.files.reading import cut
from rlco.lerobot_files.episodes import (
    episodes_v2,
    episodes_v3,
    raise_unfinished,
    select,
    tasks_v2,
    tasks_v3,
)
from rlco.lerobot_files.schema import Feature, LeRobotFolder

#: Of a feature, as messages and tables show it [characters].
LONGEST_NAME = 200
#: Dimensions of one; an image has three.
_MOST_DIMENSIONS = 8
#: Exists in a folder from the start of its recording to the end.
UNFINISHED_MARK = "meta/unfinished"
#: How rlco recorded a data set: a file of its own, which other programs leave alone.
RECORDED = "meta/rlco.json"


def read_folder(
    path: str | Path,
    *,
    episodes: Iterable[int] | Literal["present"] | None = None,
    rename: Mapping[str, str] | None = None,
) -> LeRobotFolder:
    """Read and check the metadata of a local LeRobot folder, v2.1 or v3.

    Nothing is downloaded, and neither numeric features nor images are read yet.

    Args:
        path: The folder that contains ``meta/info.json``.
        episodes: Episode indices to read, in this order; None for all, ``present``
            for those whose file exists.
        rename: ``{"their.name": "our.name"}`` for features with other names.

    Raises:
        DataError: If the folder is missing, is not a LeRobot folder, has another
            version, was never finished, is damaged, or lacks files of an episode.

    Example:
        >>> read_folder("no/such/folder")
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: data set folder 'no/such/folder' does not exist; ...
    """
    path = Path(path)
    if not path.is_dir():
        raise DataError(
            f"data set folder {str(path)!r} does not exist; give the folder that holds "
            "meta/info.json (data sets are read from disk, never downloaded)."
        )
    info = _read_info(path)
    version = _supported_version(path, info)
    if (path / UNFINISHED_MARK).exists():
        raise_unfinished(
            path,
            "its writer never reached its end; if the episodes saved until then are "
            f"enough and its parquet files are whole, delete {UNFINISHED_MARK}",
        )
    features = _features(path, info)
    videos = [name for name, f in features.items() if f.dtype == "video"]
    list_episodes = episodes_v2 if version == "v2.1" else episodes_v3
    listed = list_episodes(path, info, videos)
    if not listed:
        raise DataError(
            f"data set {str(path)!r} holds no episodes; record or copy it again."
        )
    return LeRobotFolder(
        path=path,
        version=version,
        fps=info.number("fps", above=0),
        robot_type=info.text("robot_type", None),
        features=_rename(path, features, rename or {}),
        renamed=dict(rename or {}),
        tasks=tasks_v2(path) if version == "v2.1" else tasks_v3(path),
        episodes=select(path, listed, episodes),
        recorded=_recorded(path),
    )


def _recorded(path: Path) -> Mapping[str, Any]:
    file = path / RECORDED
    return read_json(inside(path, file)).content if file.is_file() else {}


def _nearby(path: Path) -> str:
    """Name the data set that an inner folder, or one that holds it, was given for."""
    above = [path.resolve().parent, *path.resolve().parents[1:3]]
    inside = sorted(file.parents[1] for file in path.glob("*/meta/info.json"))
    for folder in above:
        if (folder / "meta" / "info.json").is_file():
            levels = above.index(folder) + 1
            meant = Path(*path.parts[:-levels]) if len(path.parts) > levels else folder
            return f"; give the folder above it that has, {str(meant)!r}"
    if inside:
        shown = " or ".join(repr(str(one)) for one in inside[:3])
        return f"; give one inside it that has, such as {shown}"
    return ""


def _read_info(path: Path) -> Fields:
    file = path / "meta" / "info.json"
    if not file.is_file():
        raise DataError(
            f"folder {str(path)!r} is not a LeRobot data set: it has no meta/info.json"
            f"{_nearby(path)}."
        )
    info = read_json(inside(path, file))
    # Together: whoever writes such a file by hand learns of all at once.
    lacking = [
        key
        for key in ("codebase_version", "fps", "features")
        if not info.content.get(key)
    ]
    if lacking:
        raise DataError(f"file {str(file)!r} lacks {', '.join(lacking)}.")
    return info


def _supported_version(path: Path, info: Fields) -> str:
    version = info.text("codebase_version")
    if version != "v2.1" and not version.startswith("v3."):
        raise DataError(
            f"data set {str(path)!r} has LeRobot version {shown(version)}; v2.1 and v3 "
            "are read, so convert it with LeRobot's own conversion scripts first."
        )
    return version


def _features(path: Path, info: Fields) -> dict[str, Feature]:
    features = {}
    for name, entry in info.mapping("features").items():
        if len(name) > LONGEST_NAME:
            raise DataError(
                f"feature {shown(name)} of data set {str(path)!r} has a name of "
                f"{len(name)} characters in meta/info.json; give it one of at most "
                f"{LONGEST_NAME}."
            )
        try:
            fields = Fields(entry, f"feature {name!r}")
            shape = _shape(fields)
            feature = Feature(name, fields.text("dtype"), shape)
        except DataError:
            raise DataError(
                f"feature {name!r} of data set {str(path)!r} has no proper dtype and "
                f"shape in meta/info.json: {shown(entry)}; correct it there."
            ) from None
        with reading(path / "meta" / "info.json"):  # names may be nested, not endlessly
            names = tuple(_flat_names(entry.get("names")))
        # For images, the names are those of axes, not of dimensions.
        if len(names) == feature.size and not feature.is_camera:
            feature = replace(feature, names=names)
        features[name] = feature
    return features


def _shape(feature: Fields) -> tuple[int, ...]:
    given = feature.sequence("shape")
    if len(given) > _MOST_DIMENSIONS:
        raise feature.refuse("shape", f"a list of at most {_MOST_DIMENSIONS} numbers")
    return tuple(
        Fields({"shape": one}, "feature").integer("shape", minimum=0) for one in given
    )


def _flat_names(names: Any) -> Iterable[str]:
    # Recorders write a list, a list in a list, or a mapping of group to list.
    if isinstance(names, str):
        yield cut(names, LONGEST_NAME)
    elif isinstance(names, Mapping):
        grouped = any(isinstance(group, list) for group in names.values())
        yield from _flat_names(list(names.values() if grouped else names))
    elif isinstance(names, list):
        for entry in names:
            yield from _flat_names(entry)


def _rename(
    path: Path, features: dict[str, Feature], rename: Mapping[str, str]
) -> dict[str, Feature]:
    for theirs, ours in rename.items():
        if theirs not in features:
            raise DataError(
                f"rename names feature {theirs!r}{suggest(theirs, features)}, which "
                f"data set {str(path)!r} does not have; it has "
                f"{few(list(features), 30)}."
            )
        if ours in features and ours not in rename:
            raise DataError(
                f"rename would give data set {str(path)!r} a second {ours!r}; rename "
                "the one it has as well."
            )
    if len(set(rename.values())) < len(rename):
        raise DataError(f"rename gives one name to several features: {dict(rename)!r}.")
    return {rename.get(name, name): feature for name, feature in features.items()}
