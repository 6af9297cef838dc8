"""A checksum in a safetensors or JSON file: a flipped bit in it does not go unnoticed.

The header of a safetensors file holds the SHA-256 of the whole file, taken while 64
zeros stand in its place; a JSON file that of its content, whatever its layout. Files
without one, written by others or before there was one, are not checked.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from rlco.errors import CheckpointError
from rlco.files.reading import reading
from rlco.files.texts import read_json

#: The entry of a header's metadata, and what stands there before it is known.
KEY, UNKNOWN = "checksum", "0" * 64
#: The file of the checksums of a folder.
BESIDE = "rlco_checksums.json"
_BLOCK = 2**20  # bytes; a file may be larger than the memory
_MOST_HEADER = 100_000_000  # bytes, safetensors' own limit


def seal(path: Path) -> None:
    """Write the checksum into a safetensors file, and wait until it is on the disk.

    Args:
        path: The file; its metadata has `UNKNOWN` under `KEY`.
    """
    with path.open("r+b") as file:
        place = _place(file, UNKNOWN)
        digest = _digest(file, place)
        file.seek(place)
        file.write(digest.encode())
        file.flush()
        os.fsync(file.fileno())


def verify(path: Path) -> bool:
    """Check a safetensors file against the checksum in it, where it has one.

    Returns:
        Whether it has one.

    Raises:
        CheckpointError: It is missing, or not what was written.
    """
    advice = "give one that rlco wrote"
    with (
        reading(path, what="checkpoint", advice=advice, error=CheckpointError),
        path.open("rb") as file,
    ):
        written = _written(file)
        if written is None:
            return False
        same = _digest(file, _place(file, written)) == written
    if not same:
        raise CheckpointError(
            f"checkpoint {str(path)!r} is damaged: its content does not match its "
            "checksum, so something changed it after it was written; copy it again, or "
            "take one from before."
        )
    return True


def seal_folder(folder: Path) -> None:
    """Write the checksums of a folder's safetensors files beside them.

    For a folder whose files another library writes, in whose headers there is no place.
    """
    digests = {
        file.name: _of_file(file) for file in sorted(folder.glob("*.safetensors"))
    }
    (folder / BESIDE).write_text(json.dumps(digests, indent=1) + "\n", "utf-8")


def verify_folder(folder: Path) -> bool:
    """Check a folder's safetensors files against the checksums beside them.

    Returns:
        Whether there are any.

    Raises:
        CheckpointError: A file is not what was written, or is gone.
    """
    path = folder / BESIDE
    if not path.is_file():
        return False
    advice = "copy the folder again, whole"
    written = read_json(path, advice=advice, error=CheckpointError)
    for name in written.content:
        file = folder / Path(name).name
        with reading(file, advice=advice, error=CheckpointError):
            found = _of_file(file)
        if found != written.text(name):
            raise CheckpointError(
                f"{str(file)!r} is damaged: its content does not match its checksum in "
                f"{BESIDE}, so something changed it after it was written; {advice}, or "
                f"take {BESIDE} away if the change was yours."
            )
    return True


def _of_file(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def content_checksum(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of what a JSON file holds but for its entry `KEY`.

    Example:
        >>> content_checksum({"a": (1, 2)}) == content_checksum({"a": [1, 2], KEY: ""})
        True
    """
    rest = {name: value for name, value in content.items() if name != KEY}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _header(file: IO[bytes]) -> bytes:
    """Return a file's header, JSON."""
    file.seek(0)
    size = int.from_bytes(file.read(8), "little")
    if size > _MOST_HEADER:
        raise ValueError(f"a header of {size} bytes")
    return file.read(size)


def _written(file: IO[bytes]) -> str | None:
    header = json.loads(_header(file))
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    found = metadata.get(KEY) if isinstance(metadata, dict) else None
    return found if isinstance(found, str) else None


def _place(file: IO[bytes], written: str) -> int:
    """Return where a checksum stands in a file."""
    return 8 + _header(file).index(f'"{KEY}":"{written}"'.encode()) + len(KEY) + 4


def _digest(file: IO[bytes], place: int) -> str:
    """Return the SHA-256 of a file as it is with `UNKNOWN` at a place."""
    digest = hashlib.sha256()
    file.seek(0)
    digest.update(file.read(place))
    digest.update(UNKNOWN.encode())
    file.seek(len(UNKNOWN), os.SEEK_CUR)
    while block := file.read(_BLOCK):
        digest.update(block)
    return digest.hexdigest()
