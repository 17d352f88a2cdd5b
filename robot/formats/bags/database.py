"""SQLite files of ROS 2, by Python's own library."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.files import open_regular
from moteslam.robot.formats.bags.containers import (
    MAX_CHUNK,
    Channel,
    Message,
    Place,
    TemporaryFolder,
    damage_in_one_line,
    plain_kind,
)


class Database:
    """A SQLite file of ROS 2: the tables ``topics`` and ``messages`` of rosbag2's storage sqlite3.

    With a ``-wal`` beside it, of a recorder that was killed, a copy of both is read: SQLite writes when it opens them.
    """

    ros1 = False
    damage: str | None = None
    temporary: TemporaryFolder | None = None

    def __init__(self, path: Path) -> None:
        self.path, self._file = path, path
        beside = path.with_name(path.name + "-wal")
        if beside.is_file() and beside.stat().st_size:
            self.temporary = TemporaryFolder()
            self._file = self.temporary.path / "copy.db3"
            shutil.copyfile(path, self._file)
            shutil.copyfile(beside, self._file.with_name("copy.db3-wal"))
            with closing(sqlite3.connect(self._file)) as connection:
                connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
            self.damage = f"the recorder was killed: {beside.name} is read with it"
        with closing(_connect(self._file)) as connection:
            _check_tables(connection, path)
            counts = dict(connection.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").fetchall())
            topics = connection.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
            self.channels = [
                Channel(number, str(name), plain_kind(str(kind)), "", counts.get(number, 0))
                for number, name, kind, encoding in topics
                if encoding == "cdr"
            ]

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """See `Container`."""
        with damage_in_one_line(self.path), closing(_connect(self._file)) as connection:
            among = ", ".join(str(int(channel)) for channel in channels)
            query = f"SELECT topic_id, timestamp, id, data FROM messages WHERE topic_id IN ({among}) ORDER BY id"
            for channel, received, row, data in connection.execute(query):
                yield Message(channel, int(received), (0, int(row)), bytes(data))

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        """See `Container`."""
        with damage_in_one_line(self.path), closing(_connect(self._file)) as connection:
            for _, row in places:
                found = connection.execute("SELECT data FROM messages WHERE id = ?", (int(row),)).fetchone()
                if found is None:
                    raise InputError(f"message {row} is not there", file=self.path)
                yield bytes(found[0])


def is_bag_database(path: Path) -> bool:
    """Whether a SQLite file has the tables of a bag, in itself or in the ``-wal`` beside it."""
    try:
        with damage_in_one_line(path):
            if path.with_name(f"{path.name}-wal").exists():
                Database(path)
            else:
                with closing(_connect(path)) as connection:
                    _check_tables(connection, path)
    except InputError:
        return False
    return True


def _connect(path: Path) -> sqlite3.Connection:
    """The file, to be read alone: no value in it is longer than a chunk."""
    open_regular(path, "a bag's SQLite file").close()
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)
    connection.execute("PRAGMA trusted_schema = OFF")
    return connection


def _check_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse what has not the two tables, as plain ones: a virtual or computed one runs what a file says."""
    tables = {
        "topics": {"id", "name", "type", "serialization_format"},
        "messages": {"id", "topic_id", "timestamp", "data"},
    }
    query = "SELECT substr(sql, 1, 100) FROM sqlite_master WHERE type = 'table' AND name = ?"
    for table, columns in tables.items():
        made = connection.execute(query, (table,)).fetchone()
        found = {row[1]: row[6] for row in connection.execute(f"PRAGMA table_xinfo({table})")}
        virtual = made is None or "virtual" in str(made[0]).lower().split("(")[0]
        if virtual or columns - found.keys() or any(found.values()):
            problem = f"no plain table {table} of {', '.join(sorted(columns))}, expected that of a ROS 2 bag"
            raise InputError(problem, file=path)
