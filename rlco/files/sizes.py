"""Declared sizes, checked before memory is taken for them."""

from __future__ import annotations

import os
from pathlib import Path

from rlco.errors import DataError

#: What numbers of a small file may take [bytes], and how much more those of a large
#: one than the file itself. Recorded numbers compress two- to fourfold; a file that
#: declares a thousand times its size was made to fill a memory.
_FREE, _RATIO = 256 * 2**20, 4
#: How much of the memory one part of a data set may take: what reads it needs the rest.
_SHARE = 0.5
#: What a container may take, where this process is in one.
_CONTAINER = Path("/sys/fs/cgroup/memory.max")


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


def check_held(needed: int, what: str, advice: str) -> None:
    """Check that half of the memory is enough for what is to be held at once.

    For what compresses so well that its file's size says nothing of it.

    Args:
        needed: Bytes that it will take.
        what: What takes them, for the message.
        advice: What to do about it.

    Raises:
        DataError: They are more than half of the machine's or the container's memory.

    Example:
        >>> check_held(10**15, "one episode", "leave it out")
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: one episode would take 1000000.0 GB of memory, and at \
most ... GB, half of what there is, are taken; leave it out.
    """
    most = _SHARE * _memory()
    if needed > most:
        raise DataError(
            f"{what} would take {needed / 1e9:.1f} GB of memory, and at most "
            f"{most / 1e9:.1f} GB, half of what there is, are taken; {advice}."
        )


def _memory() -> int:
    """Return how much memory this process may have [bytes]."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        allowed = _CONTAINER.read_text().strip()
    except OSError:
        return machine
    return min(machine, int(allowed)) if allowed.isdecimal() else machine
