"""MCAP files as containers of messages: whole ones, and those that are still being written."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.formats.bags.container import (
    MAX_MESSAGE,
    Channel,
    ChunkReader,
    Indices,
    StoredChunk,
    damage_in_one_line,
)
from moteslam.robot.formats.bags.mcap_index import DATA_END, FOOTER, MAGIC, MESSAGE, RECORD, LooseMessages, McapIndex
from moteslam.robot.growing import GrowingFile
from moteslam.robot.reading import open_regular

_EXPECTED = "an MCAP file"
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")


def _damage(path: Path) -> AbstractContextManager[None]:
    return damage_in_one_line(path, _EXPECTED, struct.error, OverflowError, ValueError)


class Mcap:
    """An MCAP file, by its index; see `Container`."""

    def __init__(self, path: Path) -> None:
        """Read the index.

        Raises:
            InputError: no MCAP file, damaged, or without messages of ROS.
        """
        self.path = path
        opening = McapIndex(path)
        with _damage(path), open_regular(path, _EXPECTED) as file:
            opening.file, opening.end = file, file.seek(0, 2)
            opening.read()
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
        self._index = McapIndex(path)
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
        with _damage(self.path), self._file.opened() as (file, end):
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
        self.damage = index.damage
        if index.builder.total == messages and not last:
            return False
        self.channels, self.ros1 = index.known_channels()
        return True

    def _index_from(self, position: int) -> None:
        loose = LooseMessages()
        for kind, content, size in self._index.whole_records(position):
            if kind in (DATA_END, FOOTER):
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
    if len(start) >= _MESSAGE_HEAD.size and start[0] == MESSAGE:
        size = _MESSAGE_HEAD.unpack_from(start)[1] - (_MESSAGE_HEAD.size - RECORD.size)
    if size > MAX_MESSAGE:
        raise InputError(f"message of {size} bytes, expected at most {MAX_MESSAGE}", file=path)
    wanted = min(size, at_most)
    data = start[_MESSAGE_HEAD.size : _MESSAGE_HEAD.size + max(wanted, 0)]
    if len(data) < wanted:
        data = reader.read(chunk, offset + _MESSAGE_HEAD.size, wanted)
    if size < 0 or len(data) < wanted:
        raise InputError(f"no whole message at offset {offset} of a chunk, where the index has one", file=path)
    return data
