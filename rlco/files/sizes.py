"""Declared sizes, checked before memory is taken for them."""

from __future__ import annotations

from pathlib import Path

from rlco.errors import DataError

#: What numbers of a small file may take [bytes], and how much more those of a large
#: one than the file itself. Recorded numbers compress two- to fourfold; a file that
#: declares a thousand times its size was made to fill a memory.
_FREE, _RATIO = 256 * 2**20, 4


def check_declared(
    path: Path, declared: int, *, of: str = "", ratio: int = _RATIO
) -> None:
    """Check that a file declares no more numbers than its size allows for.

    Args:
        path: The file.
        declared: Bytes that its content would take in memory.
        of: A part of the file, for the message.
        ratio: Of its content to the file, at most.

    Raises:
        DataError: They are more than 256 MB and `ratio` times the file.

    Example:
        >>> check_declared(Path(__file__), 10**12)
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: file '...sizes.py' of 0.0 MB declares 1000000.0 MB of \
numbers; give one that is what it says.
    """
    stored = path.stat().st_size
    if declared > _FREE + ratio * stored:
        raise DataError(
            f"{of}file {str(path)!r} of {stored / 1e6:.1f} MB declares "
            f"{declared / 1e6:.1f} MB of numbers; give one that is what it says."
        )
