"""SQLite bags: nothing is read of a database that makes up what it holds.

A column may be an expression, and a table a question to others: a few bytes then stand
for a message of a gigabyte, or for messages without end. Recorders write neither.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import apsw
from rosbags.rosbag2 import Reader, reader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from rlco.errors import DataError
from rlco.files.sizes import check_declared

#: All that rosbags reads of a bag.
_TABLES = ("schema", "topics", "message_definitions", "messages")
_SPARE = 2**20  # bytes that a small file's longest value may take beyond its size


class CheckedSqlite3Reader(Sqlite3Reader):
    """rosbags' own, which looks at what a database is before it asks it anything."""

    def open(self) -> None:
        """Open the database.

        Raises:
            DataError: It makes up what it holds, or declares more than its size allows.
        """
        path = Path(str(self.path))
        check_database(path)
        super().open()
        if self.dbconn is not None:
            _restrict(path, self.dbconn)


def check_databases() -> None:
    """Let rosbags open SQLite bags by these rules, wherever they lie."""
    # Those of a compressed bag are in a folder of its own, after it is decompressed.
    for owner, name in ((Reader, ".db3"), (reader.DirectoryReader, "sqlite3")):
        owner.STORAGE_PLUGINS = {**owner.STORAGE_PLUGINS, name: CheckedSqlite3Reader}


def check_database(path: Path) -> None:
    """Check that a bag's tables are stored as they are, and how large they are.

    Args:
        path: A ``.db3`` file.

    Raises:
        DataError: One of the tables is a view or virtual, or has a generated column,
            or a topic may be there twice, or they hold more than the file's size
            allows for.
        apsw.Error: It is no database of SQLite.
    """
    database = apsw.Connection(
        f"file:{path}?immutable=1",  # as rosbags does, which then opens the same file
        flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI,
    )
    try:
        _restrict(path, database)
        kinds: dict[str, str] = dict(
            database.execute(
                "SELECT lower(name), type FROM pragma_table_list WHERE schema = 'main'"
            )
        )
        held = sum(
            _size_of(path, database, table, kinds[table])
            for table in _TABLES
            if table in kinds
        )
        check_declared(path, held)
    finally:
        database.close()


def _restrict(path: Path, database: apsw.Connection) -> None:
    """Let a database compute nothing, and hold no value that is longer than itself."""
    database.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
    longest = path.stat().st_size + _SPARE
    database.limit(apsw.SQLITE_LIMIT_LENGTH, min(longest, 10**9))


def _size_of(path: Path, database: apsw.Connection, table: str, kind: str) -> int:
    """Return how many bytes a table's values take, which rows say of themselves.

    Raises:
        DataError: It is no plain table.
    """
    advice = "record it again, or convert it with 'ros2 bag convert'"
    if kind != "table":
        raise DataError(
            f"{table!r} of bag {str(path)!r} is a {kind}, and plain tables are read; "
            f"{advice}."
        )
    columns = database.execute(
        "SELECT name, hidden, pk FROM pragma_table_xinfo(?)", (table,)
    ).fetchall()
    made_up = [name for name, hidden, _ in columns if hidden]
    if made_up:
        raise DataError(
            f"column {made_up[0]!r} of table {table!r} of bag {str(path)!r} is "
            f"computed, and stored ones are read; {advice}."
        )
    # Else each of its messages would be read as often as a topic is there.
    if table == "topics" and [name for name, _, key in columns if key] != ["id"]:
        raise DataError(
            f"table 'topics' of bag {str(path)!r} does not have 'id' as its key, so "
            f"that a topic may be there many times; {advice}."
        )
    sizes = [f"total(octet_length({_quoted(str(name))}))" for name, _, _ in columns]
    question = f"SELECT {' + '.join(sizes)} FROM {_quoted(table)}"
    total: Any = database.execute(question).fetchall()[0][0]
    return int(total)


def _quoted(name: str) -> str:
    doubled = name.replace('"', '""')
    return f'"{doubled}"'
