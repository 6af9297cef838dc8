"""Files that are written whole or not at all; no torch."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rlco.errors import OutputExistsError, RlcoError
from rlco.files import shown


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
    above = next(one for one in path.absolute().parents if os.path.lexists(one))
    try:
        path.lstat()
    except FileNotFoundError:
        if os.access(above, os.W_OK | os.X_OK):
            return
        problem = os.strerror(errno.EACCES)
    except OSError as error:
        problem = str(error.strerror)
    raise RlcoError(
        f"output folder {shown(str(path))} cannot be made ({problem}); give another "
        "out=DIR."
    )


def remove_parts(path: Path) -> None:
    """Remove what a killed process left half written."""
    for part in [*path.rglob(".*.part")]:
        if part.is_dir():
            shutil.rmtree(part)
        else:
            part.unlink(missing_ok=True)
