"""The index of an MCAP file, record by record (mcap.dev/spec).

A file is a magic word, records of a kind, a length and content, a footer, and the magic word. Messages lie in chunks,
behind each of which stands where; a summary at the end lists the chunks. A file without a summary, as a recorder
leaves it that was killed, is gone through from its beginning, as far as it is whole.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats.bags.container import (
    MAX_CHUNK,
    Channel,
    IndexBuilder,
    StoredChunk,
    check_chunk,
    name_of,
    unpacked,
)

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x08
DATA_END = 0x0F
"""Behind it stands the summary."""
RECORD = struct.Struct("<BQ")
"""What a record begins with: its kind and the length of its content."""

_FOOTER_BYTES = 9 + 20 + len(MAGIC)
_CHUNK_HEAD = struct.Struct("<QQQI")
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
_SMALL = 8 << 20
"""Bytes of any record that is read whole: schemas, channels, indices of a chunk."""
_ENCODINGS = {"cdr": False, "ros1": True}
"""Of messages, and whether that is ROS 1's."""
_LATEST = 2**63 - 1
_NO_CHUNK = StoredChunk(0, 0, "none", 0)


class LooseMessages:
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


class McapIndex:
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
        if not footer.endswith(MAGIC) or len(footer) < _FOOTER_BYTES or footer[0] != FOOTER:
            self.damage = "it was not closed"
            return None
        (start,) = struct.unpack_from("<Q", footer, RECORD.size)
        return start if len(MAGIC) <= start < self.end else None

    def by_summary(self, start: int) -> bool:
        """Read the summary; whether it lists the chunks."""
        found: list[tuple[int, int, int]] = []
        for kind, position, size in self.records(start, self.end - _FOOTER_BYTES):
            if kind in (SCHEMA, CHANNEL, CHUNK_INDEX):
                content = self.content(position, size)
                self.note(kind, content)
                if kind == CHUNK_INDEX:
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
        if kind != CHUNK:
            raise InputError(f"no chunk at byte {start}: its summary is wrong", file=self.path)
        number = self.note_chunk(position, size)
        if not indices:
            self.scan_chunk(number)
        for kind, position, size in self.records(behind, behind + indices):
            if kind != MESSAGE_INDEX:
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
        loose = LooseMessages()
        try:
            for kind, position, size in self.records(len(MAGIC), last):
                self.enter(kind, position, size, loose)
        except (InputError, struct.error):
            if self.damage is None or not self.found:
                raise
        self.note_loose(loose)

    def enter(self, kind: int, position: int, size: int, loose: LooseMessages) -> None:
        """A record: what it says, or what messages lie in it; one outside chunks goes to the loose ones."""
        if kind in (SCHEMA, CHANNEL):
            self.note(kind, self.content(position, size))
        elif kind == CHUNK:
            self.chunks = self.chunks or [_NO_CHUNK]
            self.scan_chunk(self.note_chunk(position, size))
        elif kind == MESSAGE:
            self.file.seek(position)
            channel, _, time = struct.unpack("<HIQ", self.file.read(14))
            loose.add(channel, time, position - RECORD.size)

    def note_loose(self, loose: LooseMessages) -> None:
        """Messages outside chunks lie in one that is the file as it is now."""
        self.chunks[:1] = [StoredChunk(0, self.end, "none", self.end)]
        loose.into(self.builder, 0)

    def whole_records(self, start: int) -> Iterator[tuple[int, int, int]]:
        """As `records`, from a place on, as far as the file is whole."""
        while start + RECORD.size <= self.end:
            self.file.seek(start)
            kind, size = RECORD.unpack(self.file.read(RECORD.size))
            start += RECORD.size
            if start + size > self.end:
                return
            yield kind, start, size
            start += size

    def records(self, start: int, end: int, *, one: bool = False) -> Iterator[tuple[int, int, int]]:
        """Kind, position of the content, and its size, of the records in a part of the file."""
        while start < end:
            self.file.seek(start)
            head = self.file.read(RECORD.size)
            kind, size = RECORD.unpack(head) if len(head) == RECORD.size else (0, self.end)
            start += RECORD.size
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
        if kind == SCHEMA:
            self.schemas[number] = self.text(content, 2)[0]
        elif kind == CHANNEL:
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
        found = LooseMessages()
        position = 0
        while position + RECORD.size <= len(content):
            kind, size = RECORD.unpack_from(content, position)
            body = position + RECORD.size
            if kind == MESSAGE:
                channel, _, time = struct.unpack_from("<HIQ", content, body)
                found.add(channel, time, position)
            elif kind in (SCHEMA, CHANNEL):
                self.note(kind, content[body : body + size])
            position = body + size
        found.into(self.builder, number)

    def known_channels(self) -> tuple[tuple[Channel, ...], bool]:
        """The channels of ROS messages, and whether these are ROS 1's."""
        known = {number: found for number, found in self.found.items() if found[2] in _ENCODINGS}
        encodings = {encoding for _, _, encoding in known.values()}
        if len(encodings) != 1:
            kinds = sorted({encoding[:20] for _, _, encoding in self.found.values()})
            what = f"messages encoded as {', '.join(kinds)}" if kinds else "no channel of messages"
            raise InputError(f"{what}, expected cdr or ros1", file=self.path)
        channels = (
            self.builder.channel(number, topic, self.schemas.get(schema, ""), "")
            for number, (topic, schema, _) in known.items()
        )
        return tuple(channels), _ENCODINGS[encodings.pop()]
