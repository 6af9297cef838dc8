"""A few kilobytes that stand for gigabytes are not decompressed."""

from __future__ import annotations

import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import yaml
from backports import zstd
from log_cases import arm
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer
from test_rosbags import STATE, STORES, TYPES, states, write_bag

from rlco.errors import DataError
from rlco.gap.logs import read_log
from rlco.gap.logs.formats import bag_sizes

ZEROS = 700_000_000  # more than a bag may stand for, and less than tests may take


def write_compressed(folder: Path, mode: CompressionMode, store: str) -> Path:
    """Write the motion's joint states to a compressed bag."""
    kind, messages = states()
    bag = Writer(folder, version=9, storage_plugin=STORES[store])
    bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        connection = bag.add_connection("/joint_states", kind, typestore=TYPES)
        for stamp, message in messages:
            data = TYPES.serialize_cdr(message, kind)
            bag.write(connection, round(1e9 * stamp), data)
    return folder


MODES = [
    (CompressionMode.FILE, "mcap"),
    (CompressionMode.FILE, "db3"),
    (CompressionMode.MESSAGE, "mcap"),
    (CompressionMode.MESSAGE, "db3"),
    (CompressionMode.STORAGE, "mcap"),
]


@pytest.mark.parametrize(("mode", "store"), MODES)
def test_compressed_bags_hold_what_plain_ones_do(
    tmp_path: Path, mode: CompressionMode, store: str
) -> None:
    plain = read_log(
        write_bag(tmp_path / "plain", {"/joint_states": states()}), arm(tmp_path)
    )
    bag = write_compressed(tmp_path / "bag", mode, store)
    found = read_log(bag, arm(tmp_path))
    assert len(found.recordings) == len(plain.recordings)
    for one, other in zip(found.recordings, plain.recordings, strict=True):
        assert (one.position == other.position).all()


def peak() -> int:
    """Return the most memory that this process has had [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@pytest.mark.parametrize(
    ("name", "compress"),
    [("zstd", zstd.compress), ("lz4", lz4.frame.compress)],
)
def test_a_chunk_that_stands_for_too_much_is_refused(
    name: str, compress: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    from rosbags.rosbag2 import storage_mcap

    bag_sizes.bound_chunks()
    bomb = compress(bytes(ZEROS))
    assert len(bomb) < ZEROS / 200
    before = peak()
    with pytest.raises(DataError, match=r"a chunk of .* MB is decompressed to more"):
        storage_mcap.decompress(bomb, name, ZEROS, 0)
    assert peak() - before < ZEROS
    assert storage_mcap.decompress(compress(b"abc"), name, 3, 0) == b"abc"
    with pytest.raises(DataError, match="a chunk breaks off"):
        storage_mcap.decompress(compress(b"abc" * 99)[:-6], name, 297, 0)


def test_chunks_are_bounded_wherever_a_bag_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rosbags.rosbag2 import storage_mcap

    bag = write_compressed(tmp_path / "bag", CompressionMode.STORAGE, "mcap")
    monkeypatch.setitem(
        storage_mcap.DECOMPRESSORS, "zstd", lambda content, _: zstd.decompress(content)
    )
    monkeypatch.setattr(bag_sizes, "_FREE", 1000)
    monkeypatch.setattr(bag_sizes, "RATIO", 0)
    with pytest.raises(DataError, match=r"a chunk of .* is decompressed to more"):
        read_log(bag, arm(tmp_path))


def test_a_message_that_stands_for_too_much_is_refused(tmp_path: Path) -> None:
    bag = Writer(tmp_path / "bag", version=9, storage_plugin=STORES["db3"])
    bag.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with bag:
        connection = bag.add_connection("/joint_states", STATE, typestore=TYPES)
        bag.write(connection, 0, bytes(ZEROS))
    with pytest.raises(DataError, match=r"a message of .* MB is decompressed to more"):
        read_log(tmp_path / "bag", arm(tmp_path))


def test_a_file_that_stands_for_too_much_is_not_put_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_compressed(tmp_path / "bag", CompressionMode.FILE, "db3")
    (file,) = folder.glob("*.zstd")
    file.write_bytes(file.read_bytes() + zstd.compress(bytes(ZEROS)))

    def written(*_: Any, **__: Any) -> None:
        raise AssertionError("it was decompressed to the disk")

    monkeypatch.setattr("rosbags.rosbag2.reader.shutil.copyfileobj", written)
    with pytest.raises(DataError, match=r"declares .* MB"):
        read_log(folder, arm(tmp_path))


def test_messages_are_counted_over_all_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_compressed(tmp_path / "bag", CompressionMode.STORAGE, "mcap")
    monkeypatch.setattr(bag_sizes, "most_of", lambda _: 1000)
    with pytest.raises(DataError, match=r"holds more than .* of messages"):
        read_log(bag, arm(tmp_path))


def test_a_description_of_aliases_is_not_written_out(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", {"/joint_states": states()})
    lines = ["a0: &a0 [1, 1]"] + [
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)
    ]
    (folder / "metadata.yaml").write_text("\n".join(lines))
    with pytest.raises(DataError, match="stand for more than"):
        read_log(folder, arm(tmp_path))
    content = {"rosbag2_bagfile_information": {"compression_mode": [1]}}
    (folder / "metadata.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(DataError, match="truncated or damaged"):
        read_log(folder, arm(tmp_path))
