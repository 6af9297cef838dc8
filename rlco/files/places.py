"""Places inside a folder that others wrote: what leads out of it is refused."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from string import Formatter

from rlco.errors import DataError
from rlco.files.reading import reading, shown

# A number's width, such as 03d; nobody's data set has a billion digits.
_FORMAT = re.compile(r"0?[1-9]?d?")


def inside(folder: Path, path: Path) -> Path:
    """Return the path of a file in a folder, if it is in it, links followed.

    The blobs to which a Hugging Face cache links a snapshot's files count as inside.

    Raises:
        DataError: If it leads out of the folder.

    Example:
        >>> inside(Path("demos"), Path("demos/meta/../../secret"))
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: file 'demos/meta/../../secret' is outside of the data \
set 'demos'; copy it into the data set, where it is one of its files.
    """
    with reading(path, advice="give another path"):  # of links that go in a circle
        home, target = folder.resolve(), path.resolve()
    cache = home.parent.parent / "blobs" if home.parent.name == "snapshots" else home
    if not (target.is_relative_to(home) or target.is_relative_to(cache)):
        raise DataError(
            f"file {str(path)!r} is outside of the data set {str(folder)!r}; copy it "
            "into the data set, where it is one of its files."
        )
    return path


def check_links(folder: Path) -> None:
    """Refuse a run folder in which a link leads out of it.

    What is written to a run would be written there, and a report would hold what lies
    there. Folders that are linked are not looked into.

    Raises:
        DataError: A link does.

    Example:
        >>> check_links(Path("rlco"))
    """
    home = folder.resolve()
    for place, folders, files in os.walk(folder):
        for path in (Path(place, name) for name in (*folders, *files)):
            if not path.is_symlink():
                continue
            with reading(path, advice="remove it"):  # of links that go in a circle
                target = path.resolve()
            if not target.is_relative_to(home):
                raise DataError(
                    f"{shown(str(path.relative_to(folder)))} of run folder "
                    f"{str(folder)!r} is a link that leads out of it, to "
                    f"{shown(str(target))}; copy what "
                    "it links to into the folder, or remove it."
                )


def filled(
    template: str, values: Mapping[str, object], place: str, *, given: str
) -> str:
    """Return a template such as ``data/{episode_index:06d}.parquet`` with its values.

    Only plain fields are filled in: no attribute of a value, no item, no conversion.

    Args:
        template: The text.
        values: What may stand in it.
        place: What messages call it.
        given: The data set, for messages.

    Raises:
        DataError: If the template is no such text.

    Example:
        >>> filled("{n:03d}.mp4", {"n": 7}, "video_path", given="demos")
        '007.mp4'
        >>> filled("{n.__class__}", {"n": 7}, "video_path", given="demos")
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: video_path of data set 'demos' is '{n.__class__}'; \
give a path with no other fields than {n}.
    """
    known = ", ".join(f"{{{name}}}" for name in values)
    wrong = DataError(
        f"{place} of data set {given!r} is {shown(template)}; give a path with no "
        f"other fields than {known}."
    )
    try:
        parts = list(Formatter().parse(template))
    except ValueError:
        raise wrong from None
    for _, name, form, conversion in parts:
        if name is None:
            continue
        if name not in values or conversion or not _FORMAT.fullmatch(form or ""):
            raise wrong
        if form and not isinstance(values[name], int):
            raise wrong
    return template.format(**values)
