"""MCAP files (mcap.dev/spec), their summaries by rosbags' reader."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from rosbags.rosbag2.storage_mcap import McapReader

from moteslam.errors import InputError
from moteslam.robot.formats.bags.containers import (
    MAX_CHUNK,
    Channel,
    Chunk,
    Chunked,
    Message,
    Place,
    damage_in_one_line,
    plain_kind,
)


class Mcap(Chunked):
    """An MCAP file (mcap.dev/spec); one without a summary, or without chunks, is gone through as far as it is whole."""

    def __init__(self, path: Path) -> None:
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
            Channel(each.id, each.topic, plain_kind(each.msgtype), "", counts[each.id])
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
