"""What a model's text says before it is compiled: how much it makes, what it reads.

Both are found by reading tags, as leniently as MuJoCo does. Whatever is not plain is
still compiled within limits, see `rlco.gap.trial`.
"""

from __future__ import annotations

import os
import re
import sysconfig
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import prod
from pathlib import Path, PurePosixPath

from rlco.errors import RlcoError
from rlco.files.reading import check_kind
from rlco.files.texts import read_text
from rlco.gap.xml_tags import tags

#: Elements that replicates and the like may add to a model. MuJoCo's time grows with
#: their square, and is five seconds with 4000 bodies.
MOST = 10_000
_NUMBER = re.compile(r"0[xX][0-9a-fA-F]{1,12}|\d{1,12}")
_COUNTED = ("replicate", "flexcomp", "composite")
_SIDES = ("right", "left", "up", "down", "front", "back")
_FILES = ("file", "filename", *(f"file{side}" for side in _SIDES))
#: Levels above a model at which the ROS package is looked for that holds its meshes.
_PACKAGE = 3
#: Files that a model may include and attach.
_MANY = 200
#: Of the text of each; meshes lie in files of their own. [bytes]
LONGEST = 100_000_000


@dataclass
class _Text:
    """What the files of a model say together.

    Attributes:
        folder: Of the model's own file.
        check: Called with each file before it is read.
        elements: In the text.
        made: With all that is replicated.
        files: What is read, by the element that reads it.
        folders: Values of ``meshdir``, ``texturedir`` and ``assetdir``.
        stripped: Whether only the names of mesh files count, not their folders.
        attached: Models that are read as models of their own.
        seen: Files that were included.
    """

    folder: Path
    check: Callable[[Path], None]
    elements: int = 0
    made: int = 0
    files: list[tuple[str, str]] = field(default_factory=list)
    folders: dict[str, list[str]] = field(default_factory=dict)
    stripped: bool = False
    attached: list[Path] = field(default_factory=list)
    seen: set[Path] = field(default_factory=set)

    def read(self, source: str, times: int) -> None:
        """Take in the text of a file that is there so many times."""
        above = [times]
        for closes, name, given, empty in tags(source):
            if closes:
                del above[max(1, len(above) - 1) :]
                continue
            self.elements += 1
            self.made += above[-1]
            inner = above[-1] * (_times(given) if name in _COUNTED else 1)
            self._notice(name, given, inner)
            if not empty:
                above.append(inner)

    def _notice(self, name: str, given: dict[str, str], times: int) -> None:
        if name == "robot":  # URDF: by MuJoCo's default only names count
            self.stripped = True
        if name == "compiler":
            if "strippath" in given:
                self.stripped = given["strippath"] == "true"
            for key in ("meshdir", "texturedir", "assetdir"):
                if key in given:
                    self.folders.setdefault(key, []).append(given[key])
        self.files += [(name, given[key]) for key in _FILES if key in given]
        if name in ("include", "model") and "file" in given:
            path = self.folder / given["file"]
            if path in self.seen or not path.is_file():
                return
            self.seen.add(path)
            if name == "model":  # its paths are those of its own folder
                self.attached.append(path)
            elif len(self.seen) <= _MANY:
                self.check(path)
                self.read(text_of(path), times)

    def paths(self) -> Iterator[Path]:
        """Yield all files that may be read."""
        assets = self.folders.get("assetdir", [])
        for element, name in self.files:
            bases = ["."]
            if element not in ("include", "model"):
                kind = "texturedir" if element == "texture" else "meshdir"
                bases = self.folders.get(kind) or assets or bases
                if self.stripped:
                    name = PurePosixPath(name).name
            for base in bases:
                yield self.folder / base / name


def text_of(path: Path, *, errors: str = "replace") -> str:
    """Return the text of a model's file, or of one that it includes or attaches.

    Args:
        path: The file.
        errors: What becomes of bytes that are no text, as in `open`.

    Raises:
        RlcoError: It is missing, or longer than 100 MB.
    """
    advice = "give an MJCF or URDF file"
    return read_text(path, errors=errors, most=LONGEST, advice=advice, error=RlcoError)


def check_text(path: Path, source: str, root: Path | None = None) -> None:
    """Check how much a model makes of few words, and that it reads no foreign file.

    Args:
        path: Its file.
        source: The text in it.
        root: The folder in which all that it reads lies; None: its own, or that of the
            ROS package that it is in. What comes with installed packages may be read,
            too.

    Raises:
        RlcoError: It replicates without measure, or reads a file elsewhere, or reads
            hundreds of files.
    """
    home = (root or _package(path.parent)).resolve()

    def check(file: Path) -> None:
        _check_place(path, file, home)

    seen: set[Path] = set()
    waiting = [(path, source)]
    while waiting:
        part, its_source = waiting.pop()
        text = _Text(part.parent, check, seen=seen)
        text.read(its_source, 1)
        _check_one(path, text)
        waiting += [(file, text_of(file)) for file in text.attached[: _MANY + 1]]


def _check_one(path: Path, text: _Text) -> None:
    if len(text.seen) > _MANY:
        raise RlcoError(
            f"model {str(path)!r} includes or attaches more than {_MANY} files; write "
            "it as fewer ones."
        )
    if text.made - text.elements > MOST:
        raise RlcoError(
            f"model {str(path)!r} makes {text.made} elements of {text.elements} by "
            f"replicate, composite or flexcomp, and at most {MOST} more are compiled; "
            "give smaller counts."
        )
    for file in text.paths():
        text.check(file)


def _check_place(path: Path, file: Path, home: Path) -> None:
    """Check that a model may read a file: it is one, and lies where it should."""
    target = file.resolve()
    installed = Path(sysconfig.get_paths()["purelib"]).resolve()
    if not (target.is_relative_to(home) or target.is_relative_to(installed)):
        common = os.path.commonpath([home, target.parent])
        raise RlcoError(
            f"model {str(path)!r} reads {str(target)!r}, outside of {str(home)!r}; if "
            f"you trust the model, give model_root={common}, a folder that holds both."
        )
    check_kind(file, advice="give the model a file there", error=RlcoError)


def _package(folder: Path) -> Path:
    """Return the ROS package that a folder is in, else the folder."""
    here = folder.absolute()
    for above in [here, *here.parents][: _PACKAGE + 1]:
        if (above / "package.xml").is_file():
            return above
    return folder


def _whole(number: str) -> int:
    return int(number, 16 if number[1:2] in ("x", "X") else 10)


def _times(given: dict[str, str]) -> int:
    """Return how often what is in an element is made."""
    counts = [_whole(number) for number in _NUMBER.findall(given.get("count", ""))]
    return max(1, prod(counts))
