"""Files of messages, gone through record by record: ROS 1 (wiki.ros.org/Bags/Format/2.0) and MCAP (mcap.dev/spec).

The readers of rosbags sort messages by the time of reception, which mixes the runs of a recording whose clock was set
back, and need an index at the end. Here messages come in the order of the file, and no chunk is larger than it says.
"""

from __future__ import annotations

import bz2
import importlib
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

from moteslam.errors import InputError, MoteslamError

MAX_CHUNK = 256 << 20
"""Bytes of a chunk when it is unpacked. Recorders close one after about a megabyte, or a single larger message."""

MAX_HEADER = 1 << 20  # bytes, of a record of ROS 1

Place = tuple[int, int, int]
"""Where a message lies in its file: chunk, first byte there, bytes; of SQLite the number of its row in the middle."""

Message = tuple[int, int, Place, bytes]
"""A message: of which channel, when it was received [ns], where it lies, and its bytes."""

Read = Callable[[int, int], bytes]
"""``read(position, count)`` of a file or an unpacked chunk."""


class Channel(NamedTuple):
    """A topic of a file: its name, type (``sensor_msgs/LaserScan``), the MD5 of that in ROS 1, and the encoding."""

    topic: str
    kind: str
    digest: str
    encoding: str


class Storage(ABC):
    """A file of messages.

    Attributes:
        channels: by number.
        damage: what is missing of a file that was cut short, but can be read.
        packed: whether each message is packed by Zstandard.
    """

    packed = False

    def __init__(self, path: Path) -> None:
        self.path, self.damage = path, ""
        self.channels: dict[int, Channel] = {}

    @abstractmethod
    def totals(self) -> Mapping[int, int]:
        """How many messages each channel has."""

    @abstractmethod
    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """Those of some channels, in the order of the file."""

    @abstractmethod
    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        """The messages at some places."""


@contextmanager
def damage_in_one_line(path: Path) -> Iterator[None]:
    """The boundary to rosbags, SQLite and the packers: what they raise is an `InputError` that names the file."""
    try:
        yield
    except MoteslamError:
        raise
    except OSError as error:
        raise InputError(f"{error.strerror or error}, expected a ROS bag", file=path) from error
    except Exception as error:  # each library has exceptions of its own; a MemoryError is a size from a broken header
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"damaged: {text}", file=path) from error


def zstd() -> Any:
    """The module for Zstandard: Python's own from 3.14 on, before that the one that rosbags brings."""
    try:
        return importlib.import_module("compression.zstd")
    except ImportError:
        return importlib.import_module("backports.zstd")


def unpack(data: bytes, compression: str, limit: int) -> bytes:
    """At most ``limit`` bytes of what was packed."""
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data, max_length=limit)
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit))
    if compression == "zstd":
        return bytes(zstd().ZstdDecompressor().decompress(data, max_length=limit))
    if compression not in ("", "none"):
        raise ValueError(f"compression {compression[:20]!r}")
    return data[:limit]


class Chunk(NamedTuple):
    """A part of a file in which messages lie: first byte, bytes there, compression, bytes unpacked, and the number of
    messages of each channel.
    """

    position: int
    stored: int
    compression: str
    size: int
    counts: Counter[int]


class Chunked(Storage):
    """A file of records, some of which are chunks of further records; the latest chunk is kept unpacked."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.size = path.stat().st_size
        self.chunks: list[Chunk] = []
        self._kept: tuple[int, bytes] = (-1, b"")
        with path.open("rb") as file:
            read = _reader(file)
            self._go_through(read)
            known = self.totals().keys() <= self.channels.keys()
            for number, chunk in enumerate(self.chunks):
                if chunk.counts and known:
                    continue
                try:
                    counts = Counter(channel for channel, *_ in self._messages_in(self._unpacked(read, number)))
                except Exception:
                    if not number:
                        raise
                    self.damage = self.damage or "a chunk is damaged"
                    del self.chunks[number:]
                    break
                chunk.counts.update(() if chunk.counts else counts)

    @abstractmethod
    def _go_through(self, read: Read) -> None:
        """Find the chunks and, by their indices, which channels these hold."""

    @abstractmethod
    def _messages_in(self, data: bytes) -> Iterator[tuple[int, int, int, int]]:
        """Channel, time of reception [ns], first byte and bytes of the messages in an unpacked chunk; its channels are
        taken on the way.
        """

    def _unpacked(self, read: Read, number: int) -> bytes:
        """A chunk by its number; never more than it declares, however far it would unpack."""
        if self._kept[0] != number:
            position, stored, compression, size, _ = self.chunks[number]
            if size > MAX_CHUNK:
                raise InputError(f"chunk at byte {position} of {size} bytes unpacked, expected fewer", file=self.path)
            data = unpack(read(position, stored), compression, size + 1)
            if len(data) != size:
                problem = f"chunk at byte {position} unpacks to {'more' if len(data) > size else len(data)}"
                raise InputError(f"{problem}, expected {size} bytes", file=self.path)
            self._kept = (number, data)
        return self._kept[1]

    def totals(self) -> Mapping[int, int]:
        """See `Storage`."""
        total: Counter[int] = Counter()
        for chunk in self.chunks:
            total.update(chunk.counts)
        return total

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """See `Storage`."""
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            for number, chunk in enumerate(self.chunks):
                if not chunk.counts.keys().isdisjoint(channels):
                    data = self._unpacked(_reader(file), number)
                    for channel, received, begin, size in self._messages_in(data):
                        if channel in channels:
                            yield channel, received, (number, begin, size), data[begin : begin + size]

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        """See `Storage`."""
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            for number, begin, size in places:
                yield self._unpacked(_reader(file), number)[begin : begin + size]


def _reader(file: IO[bytes]) -> Read:
    def read(position: int, count: int) -> bytes:
        file.seek(position)
        return file.read(count)

    return read


def _within(data: bytes) -> Read:
    return lambda position, count: data[position : position + count]


def _u32(data: bytes) -> int:
    return int.from_bytes(data, "little")


class Rosbag1(Chunked):
    """A ROS 1 bag of version 2.0."""

    def _go_through(self, read: Read) -> None:
        version = read(0, 20).partition(b"\n")[0].decode(errors="replace").rpartition("V")[2]
        if version != "2.0":
            problem = f"a bag of format {version[:8]}, expected 2.0: `rosbag reindex` converts it, which the Python "
            raise InputError(f"{problem}package rosbag of rospypi.github.io has without ROS, too", file=self.path)
        end, is_closed = len("#ROSBAG V2.0\n"), False
        for operation, fields, begin, size in _ros1_records(read, end, self.size):
            end = begin + size
            if operation == 3:
                is_closed = any(fields["index_pos"])
                if fields.get("encryptor"):
                    raise InputError("encrypted, expected a plain bag", file=self.path)
            elif operation == 4:
                self.chunks[-1].counts[_u32(fields["conn"])] += _u32(fields["count"])
            elif operation == 5:
                compression, unpacked = fields["compression"].decode(), _u32(fields["size"])
                self.chunks.append(Chunk(begin, size, compression, unpacked, Counter()))
                if not size:  # the one that the recorder was writing: its messages follow, unpacked
                    self.chunks[-1] = Chunk(begin, self.size - begin, "none", self.size - begin, Counter())
                    break
            elif operation == 7:
                self._take(fields, read(begin, size))
        if end != self.size or not is_closed:
            self.damage = "it was not closed, or it is damaged"

    def _messages_in(self, data: bytes) -> Iterator[tuple[int, int, int, int]]:
        for operation, fields, begin, size in _ros1_records(_within(data), 0, len(data)):
            if operation == 7:
                self._take(fields, data[begin : begin + size])
            elif operation == 2:
                seconds, nanoseconds = struct.unpack("<II", fields["time"])
                yield _u32(fields["conn"]), seconds * 10**9 + nanoseconds, begin, size

    def _take(self, fields: dict[str, bytes], data: bytes) -> None:
        if (number := _u32(fields["conn"])) not in self.channels:
            about = _ros1_fields(data)
            topic, kind, digest = fields["topic"], about["type"], about["md5sum"]
            self.channels[number] = Channel(topic.decode(), kind.decode(), digest.decode(), "ros1")


def _ros1_records(read: Read, at: int, end: int) -> Iterator[tuple[int, dict[str, bytes], int, int]]:
    """What the whole records from a byte on are, their fields, and the first byte and the bytes of their data."""
    while at + 8 <= end:
        length = _u32(read(at, 4))
        begin = at + 8 + length
        if begin > end or length > MAX_HEADER:
            return
        head = read(at + 4, length + 4)
        fields, size = _ros1_fields(head[:length]), _u32(head[length:])
        operation = _u32(fields.get("op", b""))
        if operation == 4:
            size = 12 * _u32(fields["count"])  # rosbag of 2010 and 2011 wrote 20 bytes a message, and 12 there
        at = begin + size
        if at > end:
            return
        yield operation, fields, begin, size


def _ros1_fields(header: bytes) -> dict[str, bytes]:
    """The fields ``name=value`` of a header."""
    found, at = {}, 0
    while at + 4 <= len(header):
        end = at + 4 + _u32(header[at : at + 4])
        name, _, value = header[at + 4 : end].partition(b"=")
        found[name.decode(errors="replace")] = value
        at = end
    return found


class Mcap(Chunked):
    """An MCAP file; a message outside of chunks is one of its own."""

    def _go_through(self, read: Read) -> None:
        loose: dict[int, Counter[int]] = {}
        self._schemas: dict[int, str] = {}
        self.damage = "it was not closed"
        for operation, begin, size in _mcap_records(read, 8, self.size):
            if operation in (2, 15):  # the footer, or the end of the data
                self.damage = ""
            elif operation in (3, 4):
                self._take(operation, read(begin, size))
            elif operation == 5 and size >= 22:
                (channel,) = struct.unpack("<H", read(begin, 2))
                counts = loose.setdefault(channel, Counter({channel: 1}))
                self.chunks.append(Chunk(begin - 9, size + 9, "", size + 9, counts))
            elif operation == 6:
                head = read(begin, 100)
                compression, at = _text(head, 28)
                unpacked, stored = struct.unpack_from("<Q", head, 16)[0], struct.unpack_from("<Q", head, at)[0]
                self.chunks.append(Chunk(begin + at + 8, stored, compression, unpacked, Counter()))
            elif operation == 7 and self.chunks:
                channel, count = struct.unpack("<HI", read(begin, 6))
                self.chunks[-1].counts[channel] += count // 16

    def _messages_in(self, data: bytes) -> Iterator[tuple[int, int, int, int]]:
        for operation, begin, size in _mcap_records(_within(data), 0, len(data)):
            if operation in (3, 4):
                self._take(operation, data[begin : begin + size])
            elif operation == 5 and size >= 22:
                channel, _, received, _ = struct.unpack_from("<HIQQ", data, begin)
                yield channel, received, begin + 22, size - 22

    def _take(self, operation: int, data: bytes) -> None:
        """A schema or a channel."""
        (number,) = struct.unpack_from("<H", data)
        if operation == 3:
            self._schemas[number] = _text(data, 2)[0]
            return
        (schema,) = struct.unpack_from("<H", data, 2)
        topic, at = _text(data, 4)
        kind = self._schemas.get(schema, "").replace("/msg/", "/")
        self.channels[number] = Channel(topic, kind, "", _text(data, at)[0])


def _mcap_records(read: Read, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """What the whole records from a byte on are, the first byte and the bytes of their content."""
    while at + 9 <= end:
        operation, size = struct.unpack("<BQ", read(at, 9))
        begin, at = at + 9, at + 9 + size
        if at > end:
            return
        yield operation, begin, size


def _text(data: bytes, at: int) -> tuple[str, int]:
    """A text at a byte, and the byte after it."""
    end = at + 4 + _u32(data[at : at + 4])
    return data[at + 4 : end].decode(), end
