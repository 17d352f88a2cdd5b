"""ROS 1 bags of version 2.0 (wiki.ros.org/Bags/Format/2.0), by rosbags' reader with an index of arrays."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import reader as rosbag1

from moteslam.errors import InputError
from moteslam.robot.formats.bags.containers import (
    MAX_CHUNK,
    MAX_MESSAGES,
    UNPACKERS,
    Channel,
    Chunk,
    Chunked,
    Message,
    Place,
    damage_in_one_line,
    plain_kind,
)


class Rosbag1(Chunked):
    """A ROS 1 bag of version 2.0; one without an index is gone through, as far as it is whole."""

    ros1 = True

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with path.open("rb") as file:
            version = file.readline(20).decode(errors="replace").strip().rpartition("V")[2]
        if version != "2.0":
            problem = f"a bag of format {version[:8]}, expected 2.0: `rosbag reindex` converts it, which the Python "
            raise InputError(f"{problem}package rosbag of rospypi.github.io has without ROS, too", file=path)
        index = _Index(path)
        try:
            with index:
                self._take(index)
        except InputError:
            raise
        except Exception as error:
            index = _Index(path)
            problem = index.go_through()
            if not index.stored:
                raise error if not isinstance(error, AssertionError) else ValueError("its index") from error
            self._take(index)
            self.damage = problem
        self.check_chunks()

    def _take(self, index: _Index) -> None:
        self.chunks = list(index.stored)
        empty = np.empty((0, 4), np.int64)
        self._rows = {number: np.concatenate([empty, *found]) for number, found in index.parts.items()}
        self.channels = [
            Channel(each.id, each.topic, plain_kind(each.msgtype), each.digest, len(self._rows.get(each.id, empty)))
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


class _Index(rosbag1.Reader):  # type: ignore[misc]
    """Rosbags' reader of ROS 1 with an index of arrays.

    Its ``parts`` are, by connection, rows [n, 4] of it, time [ns], chunk and offset; its ``stored`` the chunks.

    The length of an index record is not looked at: rosbag of 2010 and 2011 wrote 20 bytes a message, and 12 there
    (ros_comm, tools/rosbag/src/rosbag/bag.py, "Workaround the possible invalid data length").
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.size = path.stat().st_size
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
        if 12 * self.total > self.size or self.total > MAX_MESSAGES:
            raise InputError(f"an index of {self.total} messages, expected fewer", file=Path(self.path))
        table = np.frombuffer(rosbag1.read_bytes(self.bio, 12 * count), "<u4").reshape(-1, 3).astype(np.int64)
        self.add(connection, table[:, 0] * 10**9 + table[:, 1], table[:, 2])

    def add(self, connection: int, times: Any, offsets: Any) -> None:
        rows = np.empty((len(times), 4), np.int64)
        rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = connection, times, len(self.stored) - 1, offsets
        self.parts.setdefault(connection, []).append(rows)

    def go_through(self) -> str:
        """Make the index of a bag that has none; what is the matter with it."""
        known: dict[int, Any] = {}
        with self.path.open("rb") as self.bio:
            self.bio.readline()
            while (begin := self.bio.tell()) < self.size:
                try:
                    header = rosbag1.Header.read(self.bio)
                    length, operation = rosbag1.read_uint32(self.bio), header.get_uint8("op")
                    end = self.bio.tell() + length
                    if header.get("encryptor") or end > self.size:
                        break
                    if operation == rosbag1.RecordType.CHUNK:
                        self.bio.seek(begin)
                        self.read_chunk()
                        if not length:  # the one that the recorder was writing: its messages follow, unpacked
                            rest = self.size - self.bio.tell()
                            self.stored[-1] = Chunk(self.bio.tell(), rest, "none", rest)
                        self._go_through_chunk(known)
                    self.bio.seek(end)
                except (rosbag1.ReaderError, InputError, ValueError, OSError, EOFError, RuntimeError):
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
        found: dict[int, list[tuple[int, int]]] = {}
        content = BytesIO(data)
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
