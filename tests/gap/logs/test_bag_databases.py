"""A SQLite bag that computes its messages is refused before one is computed."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

import pytest
from log_cases import arm
from rosbags.rosbag2 import CompressionMode
from test_bag_bombs import peak, write_compressed
from test_rosbags import states, write_bag

from rlco.errors import DataError
from rlco.files import sizes
from rlco.gap.logs import read_log

LARGE = 400_000_000  # bytes, of a message that a few letters stand for
KEYS = "id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL"
GENERATED = f"""
    DROP TABLE messages;
    CREATE TABLE messages({KEYS},
        data BLOB GENERATED ALWAYS AS (zeroblob({LARGE})) VIRTUAL);
    INSERT INTO messages(id, topic_id, timestamp) VALUES(1, 1, 5);
"""
THOUSAND = """
    WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n WHERE x < 1000)
"""
VIEW_OF_DEFINITIONS = f"""
    DROP TABLE message_definitions;
    CREATE VIEW message_definitions AS {THOUSAND} SELECT x AS id, '' AS topic_type,
        '' AS encoding, '' AS encoded_message_definition, '' AS type_description_hash
        FROM n;
"""
VIEW_OF_SCHEMA = f"""
    DROP TABLE schema;
    CREATE VIEW schema AS {THOUSAND} SELECT max(x) AS schema_version FROM n;
"""
VIRTUAL = """
    DROP TABLE messages;
    CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data);
"""
TOPIC_MANY_TIMES = f"""
    ALTER TABLE topics RENAME TO stored;
    CREATE TABLE topics AS {THOUSAND} SELECT stored.* FROM n, stored;
"""
DEFAULT = f"""
    DROP TABLE messages;
    CREATE TABLE messages({KEYS});
    {THOUSAND} INSERT INTO messages SELECT x, 1, x FROM n;
    ALTER TABLE messages ADD COLUMN data BLOB DEFAULT x'{"00" * 10_000}';
"""


def test_a_pipe_in_a_bag_is_not_waited_for(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", {"/joint_states": states()}, "db3")
    (file,) = bag.glob("*.db3")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(DataError, match=r"db3' is no file"):
        read_log(bag)


def changed(folder: Path, statements: str) -> Path:
    """Write a bag of the motion, and run statements on its database."""
    bag = write_bag(folder, {"/joint_states": states()}, "db3")
    (file,) = bag.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.executescript(statements)
    database.close()
    return file


@pytest.mark.parametrize(
    ("statements", "message"),
    [
        (GENERATED, r"column 'data' of table 'messages' .* is computed"),
        (VIEW_OF_DEFINITIONS, "'message_definitions' of bag .* is a view"),
        (VIEW_OF_SCHEMA, "'schema' of bag .* is a view"),
        (VIRTUAL, "'messages' of bag .* is a virtual"),
        (TOPIC_MANY_TIMES, "does not have 'id' as its key"),
    ],
)
@pytest.mark.parametrize("whole", [True, False])
def test_a_bag_that_makes_up_its_content_is_refused(
    tmp_path: Path, statements: str, message: str, whole: bool
) -> None:
    file = changed(tmp_path / "bag", statements)
    before = peak()
    with pytest.raises(DataError, match=message):
        read_log(file.parent if whole else file, arm(tmp_path))
    assert peak() - before < LARGE / 4


def test_a_message_that_is_stored_once_for_all_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = changed(tmp_path / "bag", DEFAULT)
    monkeypatch.setattr(sizes, "_FREE", 10**6)
    with pytest.raises(DataError, match=r"declares 10\.\d MB of numbers"):
        read_log(file, arm(tmp_path))


def test_a_database_of_a_compressed_bag_is_checked_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rlco.gap.logs.formats import bag_databases

    checked: list[Path] = []
    monkeypatch.setattr(bag_databases, "check_database", checked.append)
    bag = write_compressed(tmp_path / "bag", CompressionMode.FILE, "db3")
    read_log(bag, arm(tmp_path))
    assert [path.name for path in checked] == ["bag.db3"]


def test_a_view_of_ones_own_beside_the_messages_is_no_matter(tmp_path: Path) -> None:
    file = changed(
        tmp_path / "bag", "CREATE VIEW late AS SELECT * FROM messages WHERE id > 5"
    )
    assert read_log(file.parent, arm(tmp_path)).recordings
