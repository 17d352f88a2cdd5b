"""MCAP files: the container (mcap.dev/spec).

A file is a magic word, records of a kind, a length and content, a footer, and the magic word. Messages lie in chunks,
behind each of which stands where; a summary at the end lists the chunks. A file without a summary, as a recorder
leaves it that was killed, is gone through from its beginning, as far as it is whole.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats.bags.container import (
    MAX_CHUNK,
    MAX_MESSAGE,
    Channel,
    ChunkReader,
    IndexBuilder,
    Indices,
    StoredChunk,
    check_chunk,
    name_of,
    unpacked,
)
from moteslam.robot.growing import GrowingFile
from moteslam.robot.reading import open_regular

MAGIC = b"\x89MCAP0\r\n"

_EXPECTED = "an MCAP file"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08
_DATA_END = 0x0F
"""Behind it stands the summary."""
_FOOTER_BYTES = 9 + 20 + len(MAGIC)
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
_SMALL = 8 << 20
"""Bytes of any record that is read whole: schemas, channels, indices of a chunk."""
_ENCODINGS = {"cdr": False, "ros1": True}
"""Of messages, and whether that is ROS 1's."""
_LATEST = 2**63 - 1
_NO_CHUNK = StoredChunk(0, 0, "none", 0)


class Mcap:
    """An MCAP file, by its index; see `Container`."""

    def __init__(self, path: Path) -> None:
        """Read the index.

        Raises:
            InputError: no MCAP file, damaged, or without messages of ROS.
        """
        self.path = path
        try:
            with open_regular(path, _EXPECTED) as file:
                opening = _Index(path)
                opening.file, opening.end = file, file.seek(0, 2)
                opening.read()
        except (struct.error, OverflowError, ValueError) as error:
            raise InputError(f"damaged: {error}", file=path) from error
        except OSError as error:
            raise InputError(f"{error.strerror or error}, expected {_EXPECTED}", file=path) from error
        self.damage = opening.damage
        self.channels, self.ros1 = opening.known_channels()
        self._chunks = tuple(opening.chunks)

    def payloads(self, places: Indices, at_most: Indices) -> Iterator[bytes]:
        """See `Container`."""
        yield from _payloads(self.path, self._chunks, places, at_most)


class GrowingMcap:
    """An MCAP file that is still being written, by its index as far as it is whole; see `Container`.

    It is gone through from its beginning, a record once. Chunks count when they are whole.

    Args:
        path: of the file.

    """

    def __init__(self, path: Path) -> None:
        self.path, self.ros1 = path, False
        self.damage: str | None = None
        self.channels: tuple[Channel, ...] = ()
        self._file = GrowingFile(path, _EXPECTED)
        self._index = _Index(path)
        self._at_end = False

    def go_on(self, *, last: bool) -> bool:
        """Index what was appended since the last call; whether there was a whole message.

        Args:
            last: nothing will follow; what is missing then is `damage`.

        Raises:
            InputError: damaged, or as `GrowingFile.opened`.
        """
        index = self._index
        messages = index.builder.total
        try:
            with self._file.opened() as (file, end):
                index.file, index.end = file, end
                position = self._file.position
                if not position and end >= len(MAGIC):
                    if file.read(len(MAGIC)) != MAGIC:
                        raise InputError("does not begin as an MCAP file", file=self.path)
                    position = len(MAGIC)
                if position and not self._at_end:
                    self._index_from(position)
                if last:
                    index.summary_start()
        except (struct.error, OverflowError, ValueError) as error:
            raise InputError(f"damaged: {error}", file=self.path) from error
        self.damage = index.damage
        if index.builder.total == messages and not last:
            return False
        self.channels, self.ros1 = index.known_channels()
        return True

    def _index_from(self, position: int) -> None:
        loose = _Found()
        for kind, content, size in self._index.whole_records(position):
            if kind in (_DATA_END, _FOOTER):
                self._at_end = True
                break
            self._index.enter(kind, content, size, loose)
            position = content + size
        self._index.note_loose(loose)
        self._file.take(self._index.file, position)

    def payloads(self, places: Indices, at_most: Indices) -> Iterator[bytes]:
        """See `Container`."""
        yield from _payloads(self.path, self._index.chunks, places, at_most)


def _payloads(path: Path, chunks: Sequence[StoredChunk], places: Indices, at_most: Indices) -> Iterator[bytes]:
    with open_regular(path, _EXPECTED) as file:
        reader = ChunkReader(file, path, chunks)
        for (chunk, offset), most in zip(places.tolist(), at_most.tolist(), strict=True):
            yield _payload(path, reader, chunk, offset, most)


def _payload(path: Path, reader: ChunkReader, chunk: int, offset: int, at_most: int) -> bytes:
    start = reader.read(chunk, offset, _MESSAGE_HEAD.size + min(at_most, 512))
    size = -1
    if len(start) >= _MESSAGE_HEAD.size and start[0] == _MESSAGE:
        size = _MESSAGE_HEAD.unpack_from(start)[1] - (_MESSAGE_HEAD.size - _RECORD.size)
    if size > MAX_MESSAGE:
        raise InputError(f"message of {size} bytes, expected at most {MAX_MESSAGE}", file=path)
    wanted = min(size, at_most)
    data = start[_MESSAGE_HEAD.size : _MESSAGE_HEAD.size + max(wanted, 0)]
    if len(data) < wanted:
        data = reader.read(chunk, offset + _MESSAGE_HEAD.size, wanted)
    if size < 0 or len(data) < wanted:
        raise InputError(f"no whole message at offset {offset} of a chunk, where the index has one", file=path)
    return data


class _Found:
    """Messages that were found by going through records: 16 bytes each, for a packed chunk may hold millions."""

    def __init__(self) -> None:
        self._of: dict[int, array[int]] = {}

    def add(self, channel: int, time: int, offset: int) -> None:
        """A message of a channel, when it was logged [ns] and where it lies."""
        self._of.setdefault(channel, array("q")).extend((min(time, _LATEST), offset))

    def into(self, builder: IndexBuilder, chunk: int) -> None:
        """Add all to the index, as lying in a chunk."""
        for channel, values in self._of.items():
            table = np.array(values, np.int64).reshape(-1, 2)
            builder.add(channel, chunk, table[:, 0], table[:, 1])


class _Index:
    """What is known of the records of a file, which is open while it is read."""

    file: IO[bytes]
    end: int

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: str | None = None
        self.chunks: list[StoredChunk] = []
        self.schemas: dict[int, str] = {}
        self.found: dict[int, tuple[str, int, str]] = {}
        self.builder = IndexBuilder(path)

    def read(self) -> None:
        """The channels, the chunks, and where their messages lie."""
        self.file.seek(0)
        if self.file.read(len(MAGIC)) != MAGIC:
            raise InputError("does not begin as an MCAP file", file=self.path)
        summary = self.summary_start()
        if summary is None or not self.by_summary(summary):
            self.by_scan()

    def summary_start(self) -> int | None:
        """Where the summary begins; None where the file has none."""
        self.file.seek(max(0, self.end - _FOOTER_BYTES))
        footer = self.file.read(_FOOTER_BYTES)
        if not footer.endswith(MAGIC) or len(footer) < _FOOTER_BYTES or footer[0] != _FOOTER:
            self.damage = "it was not closed"
            return None
        (start,) = struct.unpack_from("<Q", footer, _RECORD.size)
        return start if len(MAGIC) <= start < self.end else None

    def by_summary(self, start: int) -> bool:
        """Read the summary; whether it lists the chunks."""
        found: list[tuple[int, int, int]] = []
        for kind, position, size in self.records(start, self.end - _FOOTER_BYTES):
            if kind in (_SCHEMA, _CHANNEL, _CHUNK_INDEX):
                content = self.content(position, size)
                self.note(kind, content)
                if kind == _CHUNK_INDEX:
                    (chunk,) = struct.unpack_from("<Q", content, 16)
                    length, offsets = struct.unpack_from("<QI", content, 24)
                    (indices,) = struct.unpack_from("<Q", content, 36 + offsets)
                    found.append((chunk, length, indices))
        if not found or not self.found:
            self.schemas, self.found = {}, {}
            return False
        found.sort()
        ends = [chunk + length + indices for chunk, length, indices in found]
        for (chunk, _, _), behind in zip(found, [0, *ends[:-1]], strict=True):
            if chunk < behind:
                raise InputError(f"chunk at byte {chunk} begins within another", file=self.path)
        if ends[-1] > self.end:
            raise InputError(f"cut short: its summary has a chunk up to byte {ends[-1]} of {self.end}", file=self.path)
        for chunk, length, indices in found:
            self.indexed_chunk(chunk, chunk + length, indices)
        return True

    def indexed_chunk(self, start: int, behind: int, indices: int) -> None:
        """A chunk, with the indices that stand behind it; gone through where there are none."""
        ((kind, position, size),) = self.records(start, behind, one=True)
        if kind != _CHUNK:
            raise InputError(f"no chunk at byte {start}: its summary is wrong", file=self.path)
        number = self.note_chunk(position, size)
        if not indices:
            self.scan_chunk(number)
        for kind, position, size in self.records(behind, behind + indices):
            if kind != _MESSAGE_INDEX:
                continue
            content = self.content(position, size)
            channel, length = struct.unpack_from("<HI", content)
            if length > len(content) - 6 or length % _ENTRY.itemsize:
                raise InputError(f"index at byte {position} is damaged", file=self.path)
            entries = np.frombuffer(content, _ENTRY, length // _ENTRY.itemsize, 6)
            times, offsets = (np.minimum(entries[name], _LATEST).astype(np.int64) for name in ("time", "offset"))
            self.builder.add(channel, number, times, offsets)

    def by_scan(self) -> None:
        """Go through the file from its beginning, as far as it is whole; messages outside chunks are found as well."""
        last = self.end - (0 if self.damage else _FOOTER_BYTES)
        loose = _Found()
        try:
            for kind, position, size in self.records(len(MAGIC), last):
                self.enter(kind, position, size, loose)
        except (InputError, struct.error):
            if self.damage is None or not self.found:
                raise
        self.note_loose(loose)

    def enter(self, kind: int, position: int, size: int, loose: _Found) -> None:
        """A record: what it says, or what messages lie in it; one outside chunks goes to the loose ones."""
        if kind in (_SCHEMA, _CHANNEL):
            self.note(kind, self.content(position, size))
        elif kind == _CHUNK:
            self.chunks = self.chunks or [_NO_CHUNK]
            self.scan_chunk(self.note_chunk(position, size))
        elif kind == _MESSAGE:
            self.file.seek(position)
            channel, _, time = struct.unpack("<HIQ", self.file.read(14))
            loose.add(channel, time, position - _RECORD.size)

    def note_loose(self, loose: _Found) -> None:
        """Messages outside chunks lie in one that is the file as it is now."""
        self.chunks[:1] = [StoredChunk(0, self.end, "none", self.end)]
        loose.into(self.builder, 0)

    def whole_records(self, start: int) -> Iterator[tuple[int, int, int]]:
        """As `records`, from a place on, as far as the file is whole."""
        while start + _RECORD.size <= self.end:
            self.file.seek(start)
            kind, size = _RECORD.unpack(self.file.read(_RECORD.size))
            start += _RECORD.size
            if start + size > self.end:
                return
            yield kind, start, size
            start += size

    def records(self, start: int, end: int, *, one: bool = False) -> Iterator[tuple[int, int, int]]:
        """Kind, position of the content, and its size, of the records in a part of the file."""
        while start < end:
            self.file.seek(start)
            head = self.file.read(_RECORD.size)
            kind, size = _RECORD.unpack(head) if len(head) == _RECORD.size else (0, self.end)
            start += _RECORD.size
            if start + size > self.end:
                raise InputError(f"cut short or damaged at byte {start}", file=self.path)
            yield kind, start, size
            if one:
                return
            start += size

    def content(self, position: int, size: int) -> bytes:
        """A record that is read whole."""
        if size > _SMALL:
            raise InputError(f"record of {size} bytes at byte {position}, expected at most {_SMALL}", file=self.path)
        self.file.seek(position)
        return self.file.read(size)

    def note(self, kind: int, content: bytes) -> None:
        """A schema or a channel."""
        (number,) = struct.unpack_from("<H", content)
        if kind == _SCHEMA:
            self.schemas[number] = self.text(content, 2)[0]
        elif kind == _CHANNEL:
            topic, behind = self.text(content, 4)
            self.found[number] = (topic, struct.unpack_from("<H", content, 2)[0], self.text(content, behind)[0])

    def text(self, content: bytes, position: int) -> tuple[str, int]:
        """A text, and where it ends."""
        (size,) = struct.unpack_from("<I", content, position)
        text = name_of(content[position + 4 : position + 4 + size], self.path, "a channel's name")
        return text, position + 4 + size

    def note_chunk(self, position: int, size: int) -> int:
        """The number of a chunk whose record's content begins there."""
        self.file.seek(position)
        head = self.file.read(_CHUNK_HEAD.size + 4)
        length, words = _CHUNK_HEAD.unpack_from(head)[2], struct.unpack_from("<I", head, _CHUNK_HEAD.size)[0]
        if words > 64:
            raise InputError(f"chunk at byte {position} is damaged", file=self.path)
        compression = self.file.read(words).decode(errors="replace") or "none"
        (stored,) = struct.unpack("<Q", self.file.read(8))
        chunk = StoredChunk(self.file.tell(), stored, compression, length)
        check_chunk(chunk, self.path, min(self.end, position + size))
        self.chunks.append(chunk)
        return len(self.chunks) - 1

    def scan_chunk(self, number: int) -> None:
        """Find the messages of a chunk that has no index."""
        chunk = self.chunks[number]
        self.file.seek(chunk.position)
        content = unpacked(self.file.read(min(chunk.stored, MAX_CHUNK)), chunk, self.path)
        found = _Found()
        position = 0
        while position + _RECORD.size <= len(content):
            kind, size = _RECORD.unpack_from(content, position)
            body = position + _RECORD.size
            if kind == _MESSAGE:
                channel, _, time = struct.unpack_from("<HIQ", content, body)
                found.add(channel, time, position)
            elif kind in (_SCHEMA, _CHANNEL):
                self.note(kind, content[body : body + size])
            position = body + size
        found.into(self.builder, number)

    def known_channels(self) -> tuple[tuple[Channel, ...], bool]:
        """The channels of ROS messages, and whether these are ROS 1's."""
        known = {number: found for number, found in self.found.items() if found[2] in _ENCODINGS}
        encodings = {encoding for _, _, encoding in known.values()}
        if len(encodings) != 1:
            kinds = sorted({encoding[:20] for _, _, encoding in self.found.values()}) or ["none"]
            raise InputError(f"messages encoded as {', '.join(kinds)}, expected cdr or ros1", file=self.path)
        channels = (
            self.builder.channel(number, topic, self.schemas.get(schema, ""), "")
            for number, (topic, schema, _) in known.items()
        )
        return tuple(channels), _ENCODINGS[encodings.pop()]
