"""Compressed bags: what they are decompressed to is bounded before it is.

A few kilobytes of zstd or LZ4 stand for any number of gigabytes, and rosbags looks at
how many only when it has them: of a chunk of an MCAP file, a message, or a whole file.
"""

from __future__ import annotations

from pathlib import Path, PurePath
from typing import Any

from backports import zstd
from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag2 import storage_mcap

from rlco.errors import DataError
from rlco.files import read_yaml
from rlco.files.sizes import check_declared

#: How much more recorded messages take than a compressed bag: names and stamps, which
#: each of them repeats, shrink to nothing.
RATIO = 32
_FREE = 256 * 2**20  # bytes, of a small part
_BLOCK = 2**20


def bounded(content: bytes, decompressor: Any, what: str) -> bytes:
    """Decompress a part of a bag, which may be 256 MB and 32 times its size at most.

    Args:
        content: The compressed part.
        decompressor: Of its format, new; offers ``decompress(content, max_length)``.
        what: What it is called in messages.

    Raises:
        DataError: It is larger, or breaks off.
    """
    most = _FREE + RATIO * len(content)
    found: bytes = decompressor.decompress(content, most + 1)
    if len(found) > most:
        raise DataError(
            f"{what} of {len(content) / 1e6:.1f} MB is decompressed to more than "
            f"{most / 1e6:.0f} MB; give a bag that is what it says."
        )
    if not decompressor.eof:
        raise DataError(f"{what} breaks off; copy the bag again.")
    return found


def most_of(path: Path) -> int:
    """Return how many bytes of messages a bag, a file or a folder, may hold."""
    files = path.iterdir() if path.is_dir() else [path]
    return _FREE + RATIO * sum(file.stat().st_size for file in files if file.is_file())


def message(content: bytes) -> bytes:
    """Return a message of a bag that compresses each of them.

    Raises:
        DataError: It is too large, or breaks off.
    """
    return bounded(content, zstd.ZstdDecompressor(), "a message")


def bound_chunks() -> None:
    """Let rosbags decompress chunks of MCAP files by these rules."""
    storage_mcap.DECOMPRESSORS.update(
        zstd=lambda content, _: bounded(content, zstd.ZstdDecompressor(), "a chunk"),
        lz4=lambda content, _: bounded(content, LZ4FrameDecompressor(), "a chunk"),
    )


def check_files(bag: Path) -> None:
    """Check the files of a bag that is compressed as a whole; they go to the disk.

    Args:
        bag: A bag's folder.

    Raises:
        DataError: One is decompressed to more than 256 MB and 32 times its size, or its
            ``metadata.yaml`` is none; also what is raised over a damaged one.
    """
    metadata = bag / "metadata.yaml"
    if not metadata.is_file():
        return  # rosbags says so
    content = read_yaml(metadata)
    about = content["rosbag2_bagfile_information"]
    if str(about.get("compression_mode")).lower() != "file":
        return
    for name in about["relative_file_paths"]:
        path = bag / PurePath(name).name
        with path.open("rb") as file, zstd.open(file, "rb") as stream:
            size = 0
            while block := stream.read(_BLOCK):
                size += len(block)
                check_declared(path, size, ratio=RATIO)
