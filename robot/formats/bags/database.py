"""SQLite files of ROS 2 bags: the container (the tables ``topics`` and ``messages`` of rosbag2's storage sqlite3)."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats.bags.container import (
    MAX_MESSAGE,
    MAX_MESSAGES,
    MAX_NAME,
    Channel,
    IndexBuilder,
    Indices,
    damage_in_one_line,
)
from moteslam.robot.reading import open_regular

MAGIC = b"SQLite format 3\0"

_EXPECTED = "a bag's SQLite file"
_ROWS = 65_536
_TABLES = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"id", "topic_id", "timestamp", "data"},
}


class Database:
    """A SQLite file of a ROS 2 bag, by its index; see `Container`."""

    ros1 = False
    damage: str | None = None

    def __init__(self, path: Path) -> None:
        """Read the index.

        Raises:
            InputError: no SQLite file, without the tables of a bag, or damaged.
        """
        self.path = path
        damage = damage_in_one_line(path, _EXPECTED, sqlite3.Error, OverflowError, ValueError, TypeError)
        with damage, closing(_connect(path)) as connection:
            _check_tables(connection, path)
            self.channels = _channels(connection, path)

    def payloads(self, places: Indices, at_most: Indices) -> Iterator[bytes]:
        """See `Container`."""
        with closing(_connect(self.path)) as connection:
            for (_, row), most in zip(places.tolist(), at_most.tolist(), strict=True):
                try:
                    with connection.blobopen("messages", "data", row, readonly=True) as blob:
                        if len(blob) > MAX_MESSAGE:
                            problem = f"message of {len(blob)} bytes, expected at most {MAX_MESSAGE}"
                            raise InputError(problem, file=self.path)
                        data = blob.read(min(most, len(blob)))
                except sqlite3.Error as error:
                    raise InputError(f"message {row} cannot be read: {error}", file=self.path) from error
                yield data


def is_bag_database(path: Path) -> bool:
    """Whether a SQLite file has the tables of a bag."""
    try:
        with closing(_connect(path)) as connection:
            _check_tables(connection, path)
    except (sqlite3.Error, ValueError, InputError):  # ValueError: names that are no text
        return False
    return True


def _connect(path: Path) -> sqlite3.Connection:
    """The file, to be read alone: nothing is written beside it, and no value in it is longer than a message."""
    open_regular(path, _EXPECTED).close()
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_MESSAGE + MAX_NAME)
    connection.execute("PRAGMA trusted_schema = OFF")
    return connection


def _check_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse what has not the two tables, as plain ones: a virtual one or a computed column runs what a file says."""
    for table, columns in _TABLES.items():
        made = connection.execute(
            "SELECT substr(sql, 1, 100) FROM sqlite_master WHERE type = 'table' AND name = ?", (table,)
        ).fetchone()
        if made is None or "virtual" in str(made[0]).lower().split("(")[0]:
            raise InputError(f"no plain table {table}, expected those of a ROS 2 bag", file=path)
        found = {row[1]: row[6] for row in connection.execute(f"PRAGMA table_xinfo({table})")}
        if missing := sorted(columns - found.keys()):
            raise InputError(f"table {table} has no {', '.join(missing)}, expected those of a ROS 2 bag", file=path)
        if any(found.values()):
            raise InputError(f"table {table} has computed columns, expected plain ones", file=path)


def _channels(connection: sqlite3.Connection, path: Path) -> tuple[Channel, ...]:
    count = connection.execute("SELECT count(*) FROM messages").fetchone()[0]
    if count > MAX_MESSAGES:
        raise InputError(f"{count} messages, expected at most {MAX_MESSAGES}", file=path)
    query = "SELECT id, substr(name, 1, ?), substr(type, 1, ?), serialization_format FROM topics ORDER BY id"
    topics = connection.execute(query, (MAX_NAME, MAX_NAME)).fetchall()
    builder = IndexBuilder(path)
    rows = connection.execute("SELECT rowid, topic_id, timestamp FROM messages ORDER BY rowid")
    part = 0
    while table := rows.fetchmany(_ROWS):
        row, topic, received = np.array(table, np.int64).T
        for number in np.unique(topic).tolist():
            here = topic == number
            builder.add(number, part, received[here], row[here])
        part += 1
    return tuple(
        builder.channel(number, str(name), str(kind), "")
        for number, name, kind, encoding in topics
        if encoding == "cdr"
    )
