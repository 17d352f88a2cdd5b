"""The files of a bag as rosbags opens them: ROS 1, MCAP and SQLite, their messages in the order of the file.

rosbags' own iterators sort by the time of reception, which mixes the runs of a recording whose clock was set back; so
its readers give headers, connections and indices here, and the messages are taken from the chunks in file order.
Sizes are checked before anything is read; whatever a library raises becomes one line in `damage_in_one_line`.
"""

from __future__ import annotations

import bz2
import importlib
import shutil
import sqlite3
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError, MoteslamError
from moteslam.robot.reading import open_regular

MAX_CHUNK = 256 << 20
"""Bytes of a chunk when it is unpacked. Recorders close one after about a megabyte, or a single larger message."""

MAX_MESSAGES = 20_000_000
"""No bag has more: an hour of twenty streams at 250 Hz."""

MAX_RATIO = 1000
"""No file of a recording is packed tighter."""

MAGICS = {b"#ROSBAG V": "bag", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "db3"}

Place = tuple[int, int]
"""Where a message lies in its file: a chunk and an offset."""


class Channel(NamedTuple):
    """A topic of a file: its number there, name, type (``sensor_msgs/LaserScan``), MD5 of that (ROS 1), messages."""

    number: int
    topic: str
    kind: str
    digest: str
    count: int


class Message(NamedTuple):
    """A message: of which channel, when it was received [ns], where it lies, and its bytes."""

    channel: int
    received: int
    place: Place
    data: bytes


class Container(Protocol):
    """A file of messages; ``damage`` says what is missing of it, where it was cut short but can be read."""

    path: Path
    ros1: bool
    channels: list[Channel]
    damage: str | None

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """Those of some channels, in the order of the file."""

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        """The messages at some places."""


@contextmanager
def damage_in_one_line(path: Path) -> Iterator[None]:
    """The boundary to rosbags, SQLite and the packers: what they raise is an `InputError` that names the file."""
    try:
        yield
    except (MoteslamError, GeneratorExit):
        raise
    except OSError as error:
        raise InputError(f"{error.strerror or error}, expected a ROS bag", file=path) from error
    except Exception as error:  # each library has exceptions of its own; a MemoryError is a size that is none
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"damaged: {text}", file=path) from error


def begins_as(path: Path) -> str | None:
    """The kind of bag that a file begins as, ``bag``, ``mcap`` or ``db3``, else None."""
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError:
        return None
    return next((kind for magic, kind in MAGICS.items() if start.startswith(magic)), None)


def open_container(path: Path) -> Container:
    """A file by its content.

    Raises:
        InputError: no file of a bag, or one that is damaged.
    """
    open_regular(path, "a ROS bag").close()
    kind = begins_as(path)
    if kind is None:
        raise InputError("does not begin as a ROS bag, an MCAP or a SQLite file", file=path)
    makers: dict[str, Callable[[Path], Container]] = {"bag": Rosbag1, "mcap": Mcap, "db3": Database}
    with damage_in_one_line(path):
        return makers[kind](path)


def zstd() -> Any:
    """The module for Zstandard: Python's own from 3.14 on, before that the one that rosbags brings."""
    try:
        return importlib.import_module("compression.zstd")
    except ImportError:
        return importlib.import_module("backports.zstd")


def _lz4(data: bytes, limit: int) -> bytes:
    import lz4.frame

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit))


UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda data, limit: data[:limit],
    "none": lambda data, limit: data[:limit],
    "bz2": lambda data, limit: bz2.BZ2Decompressor().decompress(data, max_length=limit),
    "lz4": _lz4,
    "zstd": lambda data, limit: bytes(zstd().ZstdDecompressor().decompress(data, max_length=limit)),
}
"""By the name of a compression, what unpacks up to a number of bytes."""


class Chunk(NamedTuple):
    """A part of a file in which messages lie: its first byte, bytes there, compression, and bytes when unpacked."""

    position: int
    stored: int
    compression: str
    size: int


class _Chunked:
    """A file of chunks, of which the last is kept unpacked."""

    ros1 = False
    damage: str | None = None

    def __init__(self, path: Path) -> None:
        self.path, self.size = path, path.stat().st_size
        self.channels: list[Channel] = []
        self.chunks: list[Chunk] = []
        self._kept: tuple[int, bytes] = (-1, b"")

    def check_chunks(self) -> None:
        """Refuse chunks that declare more than there is, or lie in each other."""
        end = 0
        for chunk in sorted(self.chunks):
            if chunk.position < end:
                raise InputError(f"chunk at byte {chunk.position} begins within another", file=self.path)
            end = chunk.position + chunk.stored
            if end > self.size or chunk.size > MAX_CHUNK or chunk.compression not in UNPACKERS:
                problem = f"chunk at byte {chunk.position} of {chunk.stored} bytes, {chunk.size} unpacked by "
                raise InputError(f"{problem}{chunk.compression[:20]!r}: cut short or damaged", file=self.path)

    def unpacked(self, file: IO[bytes], number: int) -> bytes:
        """A chunk by its number; never more than it declares, however far it would unpack."""
        if self._kept[0] != number:
            chunk = self.chunks[number]
            file.seek(chunk.position)
            data = UNPACKERS[chunk.compression](file.read(chunk.stored), chunk.size + 1)
            if len(data) != chunk.size:
                found = "more" if len(data) > chunk.size else len(data)
                problem = f"chunk at byte {chunk.position} unpacks to {found}, expected {chunk.size} bytes"
                raise InputError(problem, file=self.path)
            self._kept = (number, data)
        return self._kept[1]

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            for place in places:
                yield self._payload(file, place)

    def _payload(self, file: IO[bytes], place: Place) -> bytes:
        raise NotImplementedError


class Rosbag1(_Chunked):
    """A ROS 1 bag of version 2.0; one without an index is gone through, as far as it is whole."""

    ros1 = True

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with path.open("rb") as file:
            version = file.readline(20).decode(errors="replace").strip().rpartition("V")[2]
        if version != "2.0":
            problem = f"a bag of format {version[:8]}, expected 2.0: `rosbag reindex` converts it, which the Python "
            raise InputError(f"{problem}package rosbag of rospypi.github.io has without ROS, too", file=path)
        index = _reader1(path, self.size)
        try:
            with index:
                self._take(index)
        except InputError:
            raise
        except Exception as error:
            index = _reader1(path, self.size)
            problem = index.go_through()
            if not index.stored:
                raise error if not isinstance(error, AssertionError) else ValueError("its index") from error
            self._take(index)
            self.damage = problem
        self.check_chunks()

    def _take(self, index: Any) -> None:
        self.chunks = list(index.stored)
        parts: dict[int, list[NDArray[np.int64]]] = index.parts
        empty = np.empty((0, 4), np.int64)
        self._rows = {number: np.concatenate([empty, *found]) for number, found in parts.items()}
        self.channels = [
            Channel(each.id, each.topic, _kind(each.msgtype), each.digest, len(self._rows.get(each.id, empty)))
            for each in index.connections
        ]

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """See `Container`."""
        found = [rows for number, rows in self._rows.items() if number in channels]
        if not found:
            return
        rows = np.concatenate(found)
        order = np.lexsort((rows[:, 3], rows[:, 2]))
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            for first in range(0, len(order), 4096):
                for channel, received, number, offset in rows[order[first : first + 4096]].tolist():
                    yield Message(channel, received, (number, offset), self._payload(file, (number, offset)))

    def _payload(self, file: IO[bytes], place: Place) -> bytes:
        data, at = self.unpacked(file, place[0]), place[1]
        while True:
            (length,) = struct.unpack_from("<I", data, at)
            (size,) = struct.unpack_from("<I", data, at + 4 + length)
            begin = at + 8 + length
            if b"op=\x07" not in data[at + 4 : at + 4 + length] or begin + size >= len(data):
                break
            at = begin + size
        if begin + size > len(data) or b"op=\x02" not in data[at + 4 : at + 4 + length]:
            raise InputError(f"no whole message at byte {at} of chunk {place[0]}", file=self.path)
        return data[begin : begin + size]


def _reader1(path: Path, size: int) -> Any:
    """Rosbags' reader of ROS 1, with an index of arrays."""
    from rosbags.rosbag1 import reader as rosbag1

    class Reader(rosbag1.Reader):
        """Its ``parts`` are, by connection, rows [n, 4] of it, time [ns], chunk and offset; its ``stored`` the chunks.

        The length of an index record is not looked at: rosbag of 2010 and 2011 wrote 20 bytes a message, and 12 there
        (ros_comm, tools/rosbag/src/rosbag/bag.py, "Workaround the possible invalid data length").
        """

        def __init__(self) -> None:
            super().__init__(path)
            self.stored: list[Chunk] = []
            self.parts: dict[int, list[NDArray[np.int64]]] = {}
            self.total = 0

        def read_chunk(self) -> rosbag1.Chunk:
            assert self.bio
            header = rosbag1.Header.read(self.bio, rosbag1.RecordType.CHUNK)
            stored = rosbag1.read_uint32(self.bio)
            position = self.bio.tell()
            self.stored.append(Chunk(position, stored, header.get_string("compression"), header.get_uint32("size")))
            self.bio.seek(stored, 1)
            return rosbag1.Chunk(stored, position, bytes)

        def read_index_data(self, pos: int, indexes: dict[int, list[rosbag1.IndexData]]) -> None:
            assert self.bio
            header = rosbag1.Header.read(self.bio, rosbag1.RecordType.IDXDATA)
            self.bio.seek(4, 1)
            connection, count = header.get_uint32("conn"), header.get_uint32("count")
            self.total += count
            if 12 * self.total > size or self.total > MAX_MESSAGES:
                raise InputError(f"an index of {self.total} messages, expected fewer", file=path)
            table = np.frombuffer(rosbag1.read_bytes(self.bio, 12 * count), "<u4").reshape(-1, 3).astype(np.int64)
            self.add(connection, table[:, 0] * 10**9 + table[:, 1], table[:, 2])

        def add(self, connection: int, times: Any, offsets: Any) -> None:
            rows = np.empty((len(times), 4), np.int64)
            rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = connection, times, len(self.stored) - 1, offsets
            self.parts.setdefault(connection, []).append(rows)

        def go_through(self) -> str:
            """Make the index of a bag that has none; what is the matter with it."""
            known: dict[int, Any] = {}
            with path.open("rb") as self.bio:
                self.bio.readline()
                while (begin := self.bio.tell()) < size:
                    try:
                        header = rosbag1.Header.read(self.bio)
                        length, operation = rosbag1.read_uint32(self.bio), header.get_uint8("op")
                        end = self.bio.tell() + length
                        if header.get("encryptor") or end > size:
                            break
                        if operation == rosbag1.RecordType.CHUNK:
                            self.bio.seek(begin)
                            self.read_chunk()
                            self._go_through_chunk(known)
                        self.bio.seek(end)
                    except (rosbag1.ReaderError, InputError, ValueError, EOFError, RuntimeError):
                        break
            self.bio = None
            self.connections = list(known.values())
            return "it was not closed, or its index is damaged"

        def _go_through_chunk(self, known: dict[int, Any]) -> None:
            file = self.bio
            chunk = self.stored[-1]
            if chunk.size > MAX_CHUNK:
                self.stored.pop()
                return
            assert file
            file.seek(chunk.position)
            data = UNPACKERS[chunk.compression](file.read(chunk.stored), chunk.size)
            content, found = BytesIO(data), {}
            try:
                while (offset := content.tell()) < len(data):
                    header = rosbag1.Header.read(content)
                    operation, length = header.get_uint8("op"), rosbag1.read_uint32(content)
                    after = content.tell() + length
                    if operation == rosbag1.RecordType.CONNECTION:
                        content.seek(offset)
                        self.bio = content
                        connection = self.read_connection()
                        known.setdefault(connection.id, connection)
                    elif operation == rosbag1.RecordType.MSGDATA and after <= len(data):
                        row = (header.get_time("time"), offset)
                        found.setdefault(header.get_uint32("conn"), []).append(row)
                    content.seek(after)
            finally:
                self.bio = file
                for number, rows in found.items():
                    self.add(number, *zip(*rows, strict=True))

    return Reader()


class Mcap(_Chunked):
    """An MCAP file (mcap.dev/spec); one without a summary, or without chunks, is gone through as far as it is whole."""

    def __init__(self, path: Path) -> None:
        from rosbags.rosbag2.storage_mcap import McapReader

        super().__init__(path)
        reader = McapReader(path)
        self._loose: list[tuple[int, int, int]] = []
        with path.open("rb") as file:
            try:
                counts = self._by_summary(reader, file)
            except (InputError, MemoryError):
                raise
            except Exception:
                counts = None
            if counts is None:
                reader = McapReader(path)
                counts = self._go_through(reader, file)
        self.check_chunks()
        encodings = {each.ext.serialization_format for each in reader.connections} & {"cdr", "ros1"}
        if len(encodings) != 1:
            raise InputError(f"messages of {len(encodings)} ROS encodings, expected cdr or ros1", file=path)
        self.ros1 = encodings == {"ros1"}
        self.channels = [
            Channel(each.id, each.topic, _kind(each.msgtype), "", counts[each.id])
            for each in reader.connections
            if each.ext.serialization_format in encodings
        ]

    def _by_summary(self, reader: Any, file: IO[bytes]) -> Counter[int] | None:
        """The messages of each channel by the summary at the end; None where that does not say it."""
        file.seek(max(0, self.size - 37))
        footer = file.read()
        start = struct.unpack_from("<Q", footer, 9)[0] if footer[:1] == b"\x02" else 0
        if not footer.endswith(b"\x89MCAP0\r\n") or not 0 < start < self.size:
            return None
        reader.bio, reader.data_end = file, start
        reader.read_index()
        if not reader.chunks or not reader.channels:
            return None
        self.chunks = [
            Chunk(
                each.chunk_start_offset + 49 + len(each.compression.encode()),
                each.compressed_size,
                each.compression,
                each.uncompressed_size,
            )
            for each in sorted(reader.chunks, key=lambda each: each.chunk_start_offset)
        ]
        if reader.statistics is not None:
            return Counter(reader.statistics.channel_message_counts)
        return sum((Counter(each.channel_count) for each in reader.chunks), Counter())

    def _go_through(self, reader: Any, file: IO[bytes]) -> Counter[int]:
        """The messages of each channel, by all records of the file."""
        self.chunks, self.damage = [], "it was not closed"
        counts: Counter[int] = Counter()
        known: dict[bytes, None] = {}
        position = 8
        while position + 9 <= self.size:
            file.seek(position)
            operation, length = struct.unpack("<BQ", file.read(9))
            begin, position = position + 9, position + 9 + length
            if operation in (2, 15):  # the footer, or the end of the data: it was closed
                self.damage = None
                break
            if position > self.size:
                break
            if operation in (3, 4):
                known[struct.pack("<BQ", operation, length) + file.read(length)] = None
            elif operation == 5 and length >= 22:
                channel, _, received, _ = struct.unpack("<HIQQ", file.read(22))
                self._loose.append((channel, received, begin))
                counts[channel] += 1
            elif operation == 6:
                head = file.read(min(length, 100))
                (size,) = struct.unpack_from("<Q", head, 16)
                (letters,) = struct.unpack_from("<I", head, 28)
                name = head[32 : 32 + letters].decode()
                (stored,) = struct.unpack_from("<Q", head, 32 + letters)
                self.chunks.append(Chunk(begin + 40 + letters, stored, name, size))
                self.check_chunks()
                data = self.unpacked(file, len(self.chunks) - 1)
                for inner, at, end in _records(data):
                    if inner in (3, 4):
                        known[data[at - 9 : end]] = None
                    elif inner == 5 and end - at >= 22:
                        counts[struct.unpack_from("<H", data, at)[0]] += 1
        reader.bio, reader.data_end = BytesIO(b"".join(sorted(known)) + b"\x02"), 0  # schemas before channels
        reader.read_index()
        return counts

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """See `Container`."""
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            for number in range(len(self.chunks)):
                data = self.unpacked(file, number)
                for operation, at, end in _records(data):
                    if operation == 5 and end - at >= 22:
                        channel, _, received, _ = struct.unpack_from("<HIQQ", data, at)
                        if channel in channels:
                            yield Message(channel, received, (number, at), data[at + 22 : end])
            for channel, received, at in self._loose:
                if channel in channels:
                    yield Message(channel, received, (-1, at), self._payload(file, (-1, at)))

    def _payload(self, file: IO[bytes], place: Place) -> bytes:
        number, at = place
        if number < 0:
            file.seek(at - 8)
            (size,) = struct.unpack("<Q", file.read(8))
            return file.read(min(size, MAX_CHUNK))[22:]
        data = self.unpacked(file, number)
        (size,) = struct.unpack_from("<Q", data, at - 8)
        return data[at + 22 : at + size]


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """The records of an unpacked chunk: what it is, where its content begins and ends."""
    at = 0
    while at + 9 <= len(data):
        operation, size = struct.unpack_from("<BQ", data, at)
        if at + 9 + size > len(data):
            return
        yield operation, at + 9, at + 9 + size
        at += 9 + size


class Database:
    """A SQLite file of ROS 2: the tables ``topics`` and ``messages`` of rosbag2's storage sqlite3.

    With a ``-wal`` beside it, of a recorder that was killed, a copy of both is read: SQLite writes when it opens them.
    """

    ros1 = False
    damage: str | None = None

    def __init__(self, path: Path) -> None:
        self.path, self._file = path, path
        beside = path.with_name(path.name + "-wal")
        if beside.is_file() and beside.stat().st_size:
            self._copy = tempfile.TemporaryDirectory(prefix="moteslam-")
            self._file = Path(self._copy.name, "copy.db3")
            shutil.copyfile(path, self._file)
            shutil.copyfile(beside, self._file.with_name("copy.db3-wal"))
            with closing(sqlite3.connect(self._file)) as connection:
                connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
            self.damage = f"the recorder was killed: {beside.name} is read with it"
        with closing(self._connect()) as connection:
            self._check_tables(connection)
            (count,) = connection.execute("SELECT count(*) FROM messages").fetchone()
            if count > MAX_MESSAGES:
                raise InputError(f"{count} messages, expected at most {MAX_MESSAGES}", file=path)
            counts = dict(connection.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").fetchall())
            topics = connection.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
            self.channels = [
                Channel(number, str(name), _kind(str(kind)), "", counts.get(number, 0))
                for number, name, kind, encoding in topics
                if encoding == "cdr"
            ]

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """See `Container`."""
        with damage_in_one_line(self.path), closing(self._connect()) as connection:
            among = ", ".join(str(int(channel)) for channel in channels)
            query = f"SELECT topic_id, timestamp, id, data FROM messages WHERE topic_id IN ({among}) ORDER BY id"
            for channel, received, row, data in connection.execute(query):
                yield Message(channel, int(received), (0, int(row)), bytes(data))

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        """See `Container`."""
        with damage_in_one_line(self.path), closing(self._connect()) as connection:
            for _, row in places:
                found = connection.execute("SELECT data FROM messages WHERE id = ?", (int(row),)).fetchone()
                if found is None:
                    raise InputError(f"message {row} is not there", file=self.path)
                yield bytes(found[0])

    def _connect(self) -> sqlite3.Connection:
        """The file, to be read alone: no value in it is longer than a chunk."""
        open_regular(self._file, "a bag's SQLite file").close()
        connection = sqlite3.connect(f"{self._file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)
        connection.execute("PRAGMA trusted_schema = OFF")
        return connection

    def _check_tables(self, connection: sqlite3.Connection) -> None:
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
                raise InputError(problem, file=self.path)


def is_bag_database(path: Path) -> bool:
    """Whether a SQLite file has the tables of a bag."""
    try:
        with damage_in_one_line(path):
            Database(path)
    except InputError:
        return False
    return True


def _kind(name: str) -> str:
    return name.replace("/msg/", "/")
