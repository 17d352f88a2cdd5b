"""The files of a bag: ROS 1 (wiki.ros.org/Bags/Format/2.0), MCAP (mcap.dev/spec), SQLite of ROS 2.

The readers of rosbags sort messages by the time of reception, which mixes the runs of a recording whose clock was set
back; they need an index, and unpack chunks to any size. Here messages come in the order of the file, as far as it is
whole, and no chunk is larger than it says.
"""

import bz2
import io
import shutil
import sqlite3
import struct
import tempfile
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import IO, NamedTuple

from backports import zstd  # which rosbags brings; Python's own has it from 3.14 on
from lz4.frame import LZ4FrameDecompressor

from moteslam.errors import InputError, MoteslamError

MAX_CHUNK = 256 << 20
"""Bytes of a chunk when it is unpacked. Recorders close one after about a megabyte, or a single larger message."""
MAX_HEADER = 1 << 20  # bytes, of a record of ROS 1
ZSTD = b"\x28\xb5\x2f\xfd"  # What Zstandard packs begins so; no message of ROS 2 does
NOT_CLOSED = "it was not closed, or it is damaged"


class Topic(NamedTuple):
    """The messages of a name, with a leading slash, and a type (``sensor_msgs/LaserScan``); in ROS 1 of an MD5 of the
    type's definition; ``encoding`` is ``ros1``, ``cdr`` or one that is not read.
    """

    name: str
    kind: str
    digest: str
    encoding: str


Place = tuple[int, int, int]
"""Where a message lies in its file: first byte of its chunk, or 0, first byte there, bytes; of SQLite 0, row, 0."""
Message = tuple[Topic, int, Place, bytes]
"""A message: of which topic, when it was received [ns], where it lies, and its bytes."""


def topic_of(name: str, kind: str, digest: str, encoding: str) -> Topic:
    """The topic with its names as ROS 1 has them."""
    name = "/" + "/".join(part for part in name[:4096].split("/") if part)
    return Topic(name, kind[:4096].replace("/msg/", "/"), digest, encoding)


@contextmanager
def damage_in_one_line(path: Path) -> Iterator[None]:
    """The boundary to rosbags, SQLite and the packers: what they raise is an `InputError` that names the file."""
    try:
        yield
    except MoteslamError:
        raise
    except Exception as error:  # each library has exceptions of its own; a MemoryError is a size from a broken header
        text = getattr(error, "strerror", None) or " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"cannot be read as a ROS bag: {text}", file=path) from error


def unpack(data: bytes, compression: str, limit: int) -> bytes:
    """At most ``limit`` bytes of what was packed."""
    if compression in ("", "none"):
        return data[:limit]
    packers = {"bz2": bz2.BZ2Decompressor, "lz4": LZ4FrameDecompressor, "zstd": zstd.ZstdDecompressor}
    if compression not in packers:
        raise ValueError(f"compression {compression[:20]!r}")
    return bytes(packers[compression]().decompress(data, max_length=limit))


class _Chunk(NamedTuple):
    begin: int
    stored: int  # bytes
    compression: str
    size: int  # bytes unpacked


class _Record(NamedTuple):
    topic: int
    received: int  # [ns]
    begin: int
    size: int


class Records(ABC):
    """A file of records, some of which are chunks of further records; the latest chunk is kept unpacked.

    Attributes:
        topics: by their numbers in the file, as far as it was gone through.
        damage: what is missing of a file that can be read in part.
    """

    _start: int

    def __init__(self, path: Path) -> None:
        self.path, self.damage = path, ""
        self.topics: dict[int, Topic] = {}
        self._chunks: dict[int, _Chunk] = {}
        self._kept: tuple[int, IO[bytes]] = (0, io.BytesIO())

    @abstractmethod
    def _records(self, source: IO[bytes], at: int, end: int) -> Iterator[_Chunk | _Record]:
        """The chunks and messages between two bytes of a file or a chunk; topics are taken on the way."""

    def messages(self, wanted: Callable[[Topic], bool]) -> Iterator[Message]:
        """Those of some topics, in the order of the file."""
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            yield from self._walk(file, 0, wanted)

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        """The bytes of the messages at some places."""
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            for chunk, begin, size in places:
                yield _read(self._source(file, chunk), begin, size)

    def _walk(self, file: IO[bytes], chunk: int, wanted: Callable[[Topic], bool]) -> Iterator[Message]:
        source, is_first = self._source(file, chunk), True
        for entry in self._records(source, 0 if chunk else self._start, source.seek(0, 2)):
            if isinstance(entry, _Record):
                topic = self.topics.get(entry.topic)
                if topic is not None and wanted(topic):
                    yield topic, entry.received, (chunk, *entry[2:]), _read(source, *entry[2:])
            elif not chunk:
                self._chunks[entry.begin] = entry
                try:
                    yield from self._walk(file, entry.begin, wanted)
                except Exception:
                    if is_first:
                        raise
                    self.damage = "a chunk is damaged"
                is_first = False

    def _source(self, file: IO[bytes], begin: int) -> IO[bytes]:
        """The file itself, or an unpacked chunk of it: never more than it declares, however far it would unpack."""
        if begin and self._kept[0] != begin:
            _, stored, compression, size = self._chunks[begin]
            data = unpack(_read(file, begin, min(stored, MAX_CHUNK)), compression, min(size, MAX_CHUNK) + 1)
            if len(data) != size:
                problem = f"chunk at byte {begin}: {len(data)} bytes or more unpacked, expected {size}, fewer than 2^28"
                raise InputError(problem, file=self.path)
            self._kept = (begin, io.BytesIO(data))
        return self._kept[1] if begin else file


def _read(source: IO[bytes], begin: int, count: int) -> bytes:
    source.seek(begin)
    return source.read(count)


def _u32(data: bytes) -> int:
    return int.from_bytes(data, "little")


class Rosbag1(Records):
    """A ROS 1 bag of version 2.0. The chunk of a recorder that was killed has no size: its messages follow it."""

    _start = len("#ROSBAG V2.0\n")

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with path.open("rb") as file:
            version = file.readline(20).decode(errors="replace").strip()
        if version != "#ROSBAG V2.0":
            problem = f"a bag of format {version[-3:]}, expected 2.0: `rosbag reindex` converts it, which the Python "
            raise InputError(f"{problem}package rosbag of rospypi.github.io has without ROS, too", file=path)

    def _records(self, source: IO[bytes], at: int, end: int) -> Iterator[_Chunk | _Record]:
        is_closed = True
        while at + 8 <= end:
            length = _u32(_read(source, at, 4))
            begin = at + 8 + length
            if begin > end or length > MAX_HEADER:
                break
            head = _read(source, at + 4, length + 4)
            fields, size = _fields(head[:length]), _u32(head[length:])
            operation = _u32(fields.get("op", b""))
            if operation == 4:
                size = 12 * _u32(fields["count"])  # rosbag of 2010 and 2011 wrote 20 bytes a message, and 12 there
            if begin + size > end:
                break
            at = begin + size
            if operation == 2:
                seconds, nanoseconds = struct.unpack("<II", fields["time"])
                yield _Record(_u32(fields["conn"]), seconds * 10**9 + nanoseconds, begin, size)
            elif operation == 3:
                is_closed = any(fields["index_pos"])
                if fields.get("encryptor"):
                    raise InputError("encrypted, expected a plain bag", file=self.path)
            elif operation == 5 and size:
                yield _Chunk(begin, size, fields["compression"].decode(), _u32(fields["size"]))
            elif operation == 7:
                about = {**fields, **_fields(_read(source, begin, size))}
                name, kind, digest = (about[key].decode() for key in ("topic", "type", "md5sum"))
                self.topics.setdefault(_u32(about["conn"]), topic_of(name, kind, digest, "ros1"))
        if at != end or not is_closed:
            self.damage = NOT_CLOSED


def _fields(header: bytes) -> dict[str, bytes]:
    """The fields ``name=value`` of a header of ROS 1."""
    found, at = {}, 0
    while at + 4 <= len(header):
        end = at + 4 + _u32(header[at : at + 4])
        name, _, value = header[at + 4 : end].partition(b"=")
        found[name.decode(errors="replace")] = value
        at = end
    return found


class Mcap(Records):
    _start = 8

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._schemas: dict[int, str] = {}

    def _records(self, source: IO[bytes], at: int, end: int) -> Iterator[_Chunk | _Record]:
        is_chunk = at == 0
        while at + 9 <= end:
            operation, size = struct.unpack("<BQ", _read(source, at, 9))
            begin, at = at + 9, at + 9 + size
            if operation == 2:  # the footer
                return
            if at > end:
                break
            if operation in (3, 4):
                data = _read(source, begin, size)
                number, schema = struct.unpack_from("<HH", data)
                name, behind = _text(data, 2 if operation == 3 else 4)
                if operation == 3:
                    self._schemas[number] = name
                else:
                    self.topics[number] = topic_of(name, self._schemas.get(schema, ""), "", _text(data, behind)[0])
            elif operation == 5 and size >= 22:
                channel, _, received, _ = struct.unpack("<HIQQ", _read(source, begin, 22))
                yield _Record(channel, received, begin + 22, size - 22)
            elif operation == 6:
                head = _read(source, begin, 100)
                compression, behind = _text(head, 28)
                (unpacked,), (stored,) = (struct.unpack_from("<Q", head, place) for place in (16, behind))
                yield _Chunk(begin + behind + 8, min(stored, size), compression, unpacked)
        if at != end or not is_chunk:
            self.damage = NOT_CLOSED


def _text(data: bytes, at: int) -> tuple[str, int]:
    """A text at a byte of an MCAP record, and the byte after it."""
    end = at + 4 + _u32(data[at : at + 4])
    return data[at + 4 : end].decode(), end


class Database:
    """A SQLite file of ROS 2: the tables ``topics`` and ``messages`` of rosbag2's storage sqlite3.

    With a ``-wal`` beside it, of a recorder that was killed, a copy of both is read: SQLite writes when it opens them.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.damage = path, ""
        self.topics: dict[int, Topic] = {}
        self._file = path
        beside = path.with_name(path.name + "-wal")
        if beside.is_file() and beside.stat().st_size:
            self._file = temporary_folder(self) / "copy.db3"
            shutil.copyfile(path, self._file)
            shutil.copyfile(beside, self._file.with_name("copy.db3-wal"))
            with closing(sqlite3.connect(self._file)) as connection:
                connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
            self.damage = f"the recorder was killed: {beside.name} is read with it"
        with self._opened() as connection:
            query = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')"
            if connection.execute(query).fetchone() != (2,):  # a view would run what the file says
                raise InputError("no tables topics and messages, expected those of a ROS 2 bag", file=path)
            query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
            for number, name, kind, encoding in connection.execute(query):
                self.topics[number] = topic_of(str(name), str(kind), "", str(encoding))

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """The file, read alone; no value in it is longer than a chunk."""
        uri = f"{self._file.absolute().as_uri()}?mode=ro&immutable=1"
        with damage_in_one_line(self.path), closing(sqlite3.connect(uri, uri=True)) as connection:
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)
            connection.execute("PRAGMA trusted_schema = OFF")
            yield connection

    def messages(self, wanted: Callable[[Topic], bool]) -> Iterator[Message]:
        among = ", ".join(str(int(number)) for number, topic in self.topics.items() if wanted(topic))
        query = f"SELECT topic_id, timestamp, id, data FROM messages WHERE topic_id IN ({among}) ORDER BY id"
        with self._opened() as connection:
            for number, received, row, data in connection.execute(query):
                yield self.topics[number], int(received), (0, int(row), 0), bytes(data)

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        with self._opened() as connection:
            for _, row, _ in places:
                (data,) = connection.execute("SELECT data FROM messages WHERE id = ?", (int(row),)).fetchone()
                yield bytes(data)


def temporary_folder(owner: object) -> Path:
    """A folder that is there as long as its owner."""
    path = Path(tempfile.mkdtemp(prefix="moteslam-"))
    weakref.finalize(owner, shutil.rmtree, path, ignore_errors=True)
    return path
