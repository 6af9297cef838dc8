"""Files and folders that are written whole or not at all; no torch."""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rlco.errors import ConfigError, OutputExistsError, RlcoError
from rlco.files import shown

log = logging.getLogger(__name__)

#: After the name of a folder that is being written.
UNFINISHED = ".unfinished"


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all, in place of one that exists."""
    part = path.with_name(f".{path.name}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    put_in_place(part, path)


def put_in_place(part: Path, path: Path) -> None:
    """Give a file that is on the disk its name, and wait until that is there, too."""
    part.replace(path)
    sync_folder(path.parent)


def sync_folder(path: Path) -> None:
    """Wait until the names in a folder are on the disk; its files' content is not."""
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def sync_tree(path: Path) -> None:
    """Wait until all that is in a folder is on the disk."""
    for one in [*path.rglob("*"), path]:
        if one.is_dir():
            sync_folder(one)
        elif one.is_file():
            with one.open("rb") as file:
                os.fsync(file.fileno())


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    write_text(path, json_text(content))


def json_text(content: Mapping[str, Any]) -> str:
    """Return the text of a JSON file."""
    return json.dumps(content, indent=2) + "\n"


def check_new_folder(path: Path) -> None:
    """Check that a folder can be made, before what takes long is begun.

    Raises:
        OutputExistsError: There is one, or a file.
        RlcoError: It cannot be made there.
    """
    if os.path.lexists(path):
        raise OutputExistsError(path)
    _check_can_be_made(path, "output folder", "out=DIR")


def check_new_file(path: Path, option: str) -> None:
    """Check that a file can be made, with its folder, before what takes long is begun.

    Args:
        path: The file.
        option: What gives it, for messages.

    Raises:
        ConfigError: There is one, or a folder.
        RlcoError: It cannot be made there.
    """
    if os.path.lexists(path):
        raise ConfigError(
            [
                f"{option}={shown(str(path))} exists and is not overwritten; give a "
                f"file that does not, or leave {option} out"
            ]
        )
    _check_can_be_made(path, "file", f"{option}=FILE")


def _check_can_be_made(path: Path, what: str, another: str) -> None:
    above = next(one for one in path.absolute().parents if os.path.lexists(one))
    try:
        try:
            path.lstat()
        except FileNotFoundError:
            # Rights alone say little: root has them in /proc, where nothing is made.
            with tempfile.TemporaryFile(dir=above):
                return
    except OSError as error:
        raise RlcoError(
            f"{what} {shown(str(path))} cannot be made ({error.strerror}); give "
            f"another {another}."
        ) from error


@contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Give a folder to write into, which gets its name when all of it is on the disk.

    Until then it lies beside that name, as ``NAME.unfinished``, and no other process
    gets it. What an error or a kill leaves in it stays there, under that name.

    Args:
        path: The folder's name: of none that exists, or of one that is empty.

    Raises:
        OutputExistsError: There is something already, or another process was first.
        RlcoError: It cannot be made, another process writes it, or one that did not
            end has written a part of it.

    Example:
        >>> import tempfile
        >>> place = Path(tempfile.mkdtemp()) / "report"
        >>> with whole_folder(place) as part:
        ...     _ = (part / "a.txt").write_text("a")
        ...     part.name, place.exists()
        ('report.unfinished', False)
        >>> [file.name for file in place.iterdir()]
        ['a.txt']
    """
    target = Path(path).resolve()
    if target.exists() and not _is_empty(target):
        raise OutputExistsError(path)
    part = target.with_name(target.name + UNFINISHED)
    made = [folder for folder in (part, *part.parents) if not folder.exists()]
    lock = _claimed(part, path)
    try:
        yield part
        sync_tree(part)
        _rename(part, target, path)
    finally:
        os.close(lock)
        _remove_empty([part, *made])
        if part.exists():
            log.warning("what was written until then is in %s", part)
    sync_folder(target.parent)


def _is_empty(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _claimed(part: Path, path: str | Path) -> int:
    """Make a folder and lock it for this process; return what unlocks it if closed."""
    try:
        part.mkdir(parents=True, exist_ok=True)
        lock = os.open(part, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise RlcoError(
            f"output folder {shown(str(path))} cannot be made ({error.strerror}); give "
            "another out=DIR."
        ) from error
    problem = None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        problem = "is being written by another process; wait for it to end"
    else:
        if any(part.iterdir()):
            problem = (
                "holds what was written by a process that did not end; take it away"
            )
    if problem is not None:
        os.close(lock)
        raise RlcoError(f"{shown(str(part))} {problem}, or give another out=DIR.")
    return lock


def _rename(part: Path, target: Path, path: str | Path) -> None:
    try:
        part.rename(target)  # an empty folder is replaced
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
            raise OutputExistsError(path) from error
        raise


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders, inner ones first, up to one that holds something."""
    for folder in folders:
        try:
            folder.rmdir()
        except FileNotFoundError:
            continue
        except OSError:
            return


def remove_parts(path: Path) -> None:
    """Remove what a killed process left half written."""
    for part in [*path.rglob(".*.part")]:
        if part.is_dir() and not part.is_symlink():
            shutil.rmtree(part)
        else:
            part.unlink(missing_ok=True)
