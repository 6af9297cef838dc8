"""A fingerprint is of every byte: what was changed in place does not go unnoticed."""

from __future__ import annotations

from pathlib import Path

import pytest

from rlco.files.fingerprints import fingerprint


@pytest.mark.parametrize("place", [0, 20_000_000, 69_999_999])
def test_one_byte_of_a_large_file_counts(tmp_path: Path, place: int) -> None:
    file = tmp_path / "film.mp4"
    with file.open("wb") as stream:
        stream.truncate(70_000_000)  # zeros, which take no room on the disk
    before = fingerprint(tmp_path)
    with file.open("r+b") as stream:
        stream.seek(place)
        stream.write(b"x")
    assert fingerprint(tmp_path) != before
