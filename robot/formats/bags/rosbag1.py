"""ROS 1 bags: the container, version 2.0 (wiki.ros.org/Bags/Format/2.0).

A file is a line, then records: a header of fields ``name=value`` and data, each with its length before it. Messages
lie in chunks; the index behind them says in which, and where. Only index records are read on opening.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats.bags.container import (
    MAX_DEFINITION,
    MAX_MESSAGE,
    Channel,
    ChunkReader,
    IndexBuilder,
    Indices,
    StoredChunk,
    check_chunk,
    damage_in_one_line,
    name_of,
)
from moteslam.robot.reading import open_regular

MAGIC = b"#ROSBAG V2.0\n"

_EXPECTED = "a ROS bag"
_HEADER = 1 << 20
"""Bytes of a record's header, at most: fields are numbers, and names."""

_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
_AHEAD, _MORE = 128, 1024
"""Bytes that are read at a message's place before its length is known: for its header, which takes some 40, and for
its beginning."""
_LENGTH = struct.Struct("<I")
_IS_MESSAGE = b"op=\x02"

Fields = dict[bytes, bytes]


class Rosbag1:
    """A ROS 1 bag, by its index; see `Container`."""

    ros1 = True
    damage: str | None = None

    def __init__(self, path: Path) -> None:
        """Read the index.

        Raises:
            InputError: no bag, one that was not closed, encrypted, cut short or damaged.
        """
        self.path = path
        damage = damage_in_one_line(path, _EXPECTED, struct.error, OverflowError)
        with damage, open_regular(path, _EXPECTED) as file:
            self.channels, self._chunks = _Opening(file, path).read()

    def payloads(self, places: Indices, at_most: Indices) -> Iterator[bytes]:
        """See `Container`."""
        with open_regular(self.path, _EXPECTED) as file:
            reader = ChunkReader(file, self.path, self._chunks)
            for (chunk, offset), most in zip(places.tolist(), at_most.tolist(), strict=True):
                start = reader.read(chunk, offset, _AHEAD + most if most < _MORE else _AHEAD + _MORE)
                begin = 8 + _LENGTH.unpack_from(start)[0] if len(start) >= 4 else len(start) + 1
                if begin <= len(start) and _IS_MESSAGE in start[4:begin]:  # as nearly always
                    size = _LENGTH.unpack_from(start, begin - 4)[0]
                    end = begin + (size if size < most else most)
                    if end <= len(start):
                        yield start[begin:end]
                        continue
                yield self._payload(reader, chunk, offset, most)

    def _payload(self, reader: ChunkReader, chunk: int, offset: int, at_most: int) -> bytes:
        while True:
            start = reader.read(chunk, offset, _AHEAD + min(at_most, _MORE))
            if len(start) < 4:
                raise self._nothing_at(offset)
            (length,) = struct.unpack_from("<I", start)
            if length > _HEADER:
                raise self._nothing_at(offset)
            begin = 4 + length + 4
            if begin > len(start):
                start = reader.read(chunk, offset, begin)
                if len(start) < begin:
                    raise self._nothing_at(offset)
            (size,) = struct.unpack_from("<I", start, 4 + length)
            if _IS_MESSAGE in start[4 : 4 + length]:
                break
            if b"op=\x07" not in start[4 : 4 + length]:  # a connection may stand before its first message
                raise self._nothing_at(offset)
            offset += begin + size
        if size > MAX_MESSAGE:
            raise InputError(f"message of {size} bytes, expected at most {MAX_MESSAGE}", file=self.path)
        wanted = min(size, at_most)
        data = start[begin : begin + wanted]
        if len(data) < wanted:
            data = reader.read(chunk, offset + begin, wanted)
            if len(data) < wanted:
                raise self._nothing_at(offset)
        return data

    def _nothing_at(self, offset: int) -> InputError:
        return InputError(f"no whole message at offset {offset} of a chunk, where the index has one", file=self.path)


class _Opening:
    """What is read while a bag is opened."""

    def __init__(self, file: IO[bytes], path: Path) -> None:
        self.file, self.path = file, path
        self.end = file.seek(0, 2)
        file.seek(0)

    def read(self) -> tuple[tuple[Channel, ...], tuple[StoredChunk, ...]]:
        """The channels and the chunks."""
        if self.file.read(len(MAGIC)) != MAGIC:
            raise InputError("does not begin as a ROS bag of version 2.0", file=self.path)
        fields, _ = self.record(_BAG)
        index, connections, chunks = (
            self.number(fields, name, kind)
            for name, kind in (("index_pos", "<Q"), ("conn_count", "<I"), ("chunk_count", "<I"))
        )
        if fields.get(b"encryptor"):
            raise InputError("encrypted, expected a plain bag", file=self.path)
        if index == 0:
            problem = "was not closed and has no index, expected one: rosbag reindex makes it"
            raise InputError(problem, file=self.path)
        if index > self.end:
            raise InputError(f"cut short: its index is at byte {index} of {self.end}", file=self.path)
        self.file.seek(index)
        known = dict(self.connection() for _ in range(connections))
        positions = [self.chunk_info() for _ in range(chunks)]
        builder = IndexBuilder(self.path)
        stored = []
        behind = 0
        for number, (position, count) in enumerate(sorted(positions)):
            if position < behind:
                raise InputError(f"chunk at byte {position} begins within another", file=self.path)
            self.file.seek(min(position, self.end))
            stored.append(self.chunk())
            for _ in range(count):
                self.index(number, builder)
            behind = self.file.tell()
        channels = (builder.channel(number, *names) for number, names in known.items())
        return tuple(channels), tuple(stored)

    def record(self, op: int) -> tuple[Fields, int]:
        """The fields of the next record, which is of that kind, and the length of its data, where the file is then."""
        data = self.file.read(4)
        (length,) = struct.unpack("<I", data) if len(data) == 4 else (0,)
        header = self.file.read(min(length, _HEADER))
        data = self.file.read(4)
        if not length or len(header) < length or len(data) < 4:
            raise InputError(f"cut short or damaged at byte {self.file.tell()}", file=self.path)
        fields = _fields(header, self.path)
        if fields.get(b"op", b"\0")[0] != op:
            raise InputError(f"no record {op} before byte {self.file.tell()}: its index is wrong", file=self.path)
        return fields, struct.unpack("<I", data)[0]

    def number(self, fields: Fields, name: str, kind: str) -> int:
        """A field as a whole number."""
        value = fields.get(name.encode(), b"")
        if len(value) != struct.calcsize(kind):
            raise InputError("missing or no number", file=self.path, field=name)
        return int(struct.unpack(kind, value)[0])

    def connection(self) -> tuple[int, tuple[str, str, str]]:
        """A connection: its number, topic, type and the digest of that."""
        fields, size = self.record(_CONNECTION)
        if size > MAX_DEFINITION:
            raise InputError(f"message definition of {size} bytes, expected at most {MAX_DEFINITION}", file=self.path)
        data = self.file.read(size)
        if len(data) < size:
            raise InputError(f"cut short or damaged at byte {self.end}", file=self.path)
        about = _fields(data, self.path)
        names = (fields.get(b"topic", b""), about.get(b"type", b""), about.get(b"md5sum", b""))
        topic, kind, digest = (name_of(name, self.path, "a connection's name") for name in names)
        return self.number(fields, "conn", "<I"), (topic, kind, digest)

    def chunk_info(self) -> tuple[int, int]:
        """Where a chunk is, and how many index records follow it."""
        fields, size = self.record(_CHUNK_INFO)
        self.file.seek(size, 1)
        return self.number(fields, "chunk_pos", "<Q"), self.number(fields, "count", "<I")

    def chunk(self) -> StoredChunk:
        """The next record, a chunk; the file is behind it then."""
        fields, stored = self.record(_CHUNK)
        compression = name_of(fields.get(b"compression", b""), self.path, "a compression's name")
        chunk = StoredChunk(self.file.tell(), stored, compression, self.number(fields, "size", "<I"))
        check_chunk(chunk, self.path, self.end)
        self.file.seek(stored, 1)
        return chunk

    def index(self, chunk: int, builder: IndexBuilder) -> None:
        """The next record, where the messages of a connection lie in a chunk."""
        fields, size = self.record(_INDEX)
        count = self.number(fields, "count", "<I")
        if size != count * _ENTRY.itemsize or self.file.tell() + size > self.end:
            raise InputError(f"index of {count} messages takes {size} bytes: cut short or damaged", file=self.path)
        entries = np.frombuffer(self.file.read(size), _ENTRY)
        received = entries["sec"].astype(np.int64) * 1_000_000_000 + entries["nsec"]
        builder.add(self.number(fields, "conn", "<I"), chunk, received, entries["offset"].astype(np.int64))


def _fields(data: bytes, path: Path) -> Fields:
    """The fields of a header."""
    fields: Fields = {}
    position = 0
    while position < len(data):
        (length,) = struct.unpack_from("<I", data, position)
        name, equals, value = data[position + 4 : position + 4 + length].partition(b"=")
        if not equals or position + 4 + length > len(data):
            raise InputError("a record's header is damaged", file=path)
        fields[name] = value
        position += 4 + length
    return fields
