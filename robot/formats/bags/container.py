"""What the kinds of bags have in common: channels of messages, each with the place in the file where it lies.

A container is its index alone, as arrays; the file is opened anew whenever messages are asked for, so that nothing
stays open and nothing but the index stays in memory.
"""

from __future__ import annotations

import bz2
import importlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError

MAX_MESSAGES = 20_000_000
"""No bag has more: an hour of twenty streams at 250 Hz."""

MAX_CHUNK = 256 << 20
"""Bytes of a chunk when it is unpacked. Recorders close one after about a megabyte, or a single larger message."""

MAX_MESSAGE = 64 << 20
"""Bytes of a message: larger than any scan, image or cloud of a robot's."""

MAX_NAME = 4096
"""Bytes of a topic's or a type's name."""

MAX_DEFINITION = 4 << 20
"""Bytes of the message definitions that a channel brings."""


@contextmanager
def damage_in_one_line(path: Path, expected: str, *errors: type[Exception]) -> Iterator[None]:
    """Turn what a reader of a broken file raises into a refusal that names the file.

    Args:
        path: of the file.
        expected: what it should be, where it cannot be read at all.
        errors: by which the reader stumbles over content that is damaged.

    Raises:
        InputError: one of these, or of the system.
    """
    try:
        yield
    except errors as error:
        raise InputError(f"damaged: {error}", file=path) from error
    except OSError as error:
        raise InputError(f"{error.strerror or error}, expected {expected}", file=path) from error


Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Channel:
    """The messages of one topic in one file.

    Attributes:
        topic: its name, with a leading slash.
        kind: the type of its messages without the ``msg`` of ROS 2: ``sensor_msgs/LaserScan``.
        digest: of the type's definition, where the container states one, as ROS 1 does.
        received: [n] when each message was received [ns], in the order of the file.
        places: [n, 2] where each lies, as its container counts: a chunk and an offset.
    """

    topic: str
    kind: str
    digest: str
    received: Indices
    places: Indices


class Container(Protocol):
    """A file of messages.

    Attributes:
        path: of the file.
        ros1: whether messages are serialised as in ROS 1, else as CDR.
        channels: that it holds, empty ones too.
        damage: what is missing of it, where it was cut short but can be read; else None.
    """

    path: Path
    ros1: bool
    channels: tuple[Channel, ...]
    damage: str | None

    def payloads(self, places: Indices, at_most: Indices) -> Iterator[bytes]:
        """The messages at some places [m, 2], in that order, of each up to ``at_most`` [m] bytes.

        Raises:
            InputError: a chunk that is damaged, or no message at a place.
        """


@dataclass(frozen=True)
class StoredChunk:
    """A part of a file in which messages lie.

    Attributes:
        position: of its first byte in the file.
        stored: how many bytes it takes there.
        compression: ``none``, ``bz2``, ``lz4`` or ``zstd``.
        size: when it is unpacked.
    """

    position: int
    stored: int
    compression: str
    size: int


class ChunkReader:
    """Reads parts of chunks; of packed ones the last is kept unpacked.

    Args:
        file: open for reading.
        path: for messages.
        chunks: by number.
    """

    def __init__(self, file: IO[bytes], path: Path, chunks: Sequence[StoredChunk]) -> None:
        self._file, self._path, self._chunks = file, path, chunks
        self._kept: tuple[int, bytes] = (-1, b"")

    def read(self, number: int, offset: int, size: int) -> bytes:
        """Up to ``size`` bytes of a chunk from an offset in it; fewer at its end."""
        chunk = self._chunks[number]
        if offset < 0 or offset >= chunk.size:
            return b""
        if chunk.compression == "none":
            self._file.seek(chunk.position + offset)
            return self._file.read(min(size, chunk.stored - offset) if offset < chunk.stored else 0)
        return self.whole(number)[offset : offset + size]

    def whole(self, number: int) -> bytes:
        """A chunk, unpacked.

        Raises:
            InputError: it is cut short, damaged, or unpacks to another size than it declares.
        """
        if self._kept[0] != number:
            chunk = self._chunks[number]
            self._file.seek(chunk.position)
            self._kept = (number, unpacked(self._file.read(chunk.stored), chunk, self._path))
        return self._kept[1]


def check_chunk(chunk: StoredChunk, path: Path, end: int) -> None:
    """Refuse a chunk that declares more than there is, or than any recorder puts into one.

    Args:
        chunk: as the file declares it.
        path: of the file.
        end: of the file [bytes].

    Raises:
        InputError: one line says what.
    """
    if chunk.position + chunk.stored > end:
        raise InputError(f"chunk at byte {chunk.position} is cut short, expected {chunk.stored} bytes", file=path)
    if chunk.size > MAX_CHUNK:
        raise InputError(f"chunk of {chunk.size} bytes unpacked, expected at most {MAX_CHUNK}", file=path)
    if chunk.compression not in _UNPACKERS:
        known = ", ".join(_UNPACKERS)
        raise InputError(f"chunk packed as {chunk.compression[:20]!r}, expected one of {known}", file=path)


def unpacked(data: bytes, chunk: StoredChunk, path: Path) -> bytes:
    """The content of a chunk: never more than it declares, however far it would unpack.

    Raises:
        InputError: it is damaged, or unpacks to another size than it declares.
    """
    try:
        content = _UNPACKERS[chunk.compression](data, chunk.size + 1)
    except ImportError as error:
        raise missing_extra(path) from error
    except Exception as error:  # each library has exceptions of its own
        problem = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"chunk at byte {chunk.position} is damaged: {problem}", file=path) from error
    if len(content) != chunk.size:
        found = f"unpacks to {'more' if len(content) > chunk.size else len(content)}"
        raise InputError(f"chunk at byte {chunk.position} {found}, expected {chunk.size} bytes", file=path)
    return content


def missing_extra(path: Path) -> InputError:
    """The error of a bag that cannot be read or written without the packages of the extra ``bags``."""
    return InputError("a ROS bag, expected the extra: pip install 'moteslam[bags]'", file=path)


def _lz4(data: bytes, limit: int) -> bytes:
    import lz4.frame

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit))


def _zstd(data: bytes, limit: int) -> bytes:
    decompressor: Any = zstd().ZstdDecompressor()
    return bytes(decompressor.decompress(data, max_length=limit))


def zstd() -> Any:
    """The module for Zstandard: Python's own from 3.14 on, before that the one that rosbags brings."""
    try:
        return importlib.import_module("compression.zstd")
    except ImportError:
        return importlib.import_module("backports.zstd")


_UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {
    "none": lambda data, limit: data[:limit],
    "bz2": lambda data, limit: bz2.BZ2Decompressor().decompress(data, max_length=limit),
    "lz4": _lz4,
    "zstd": _zstd,
}


class IndexBuilder:
    """Collects where the messages of channels lie.

    Args:
        path: of the file, for messages.

    Attributes:
        total: messages that were added.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.total = 0
        self._parts: dict[int, list[tuple[Indices, Indices, Indices]]] = {}

    def add(self, channel: int, chunk: int, received: Indices, offsets: Indices) -> None:
        """Messages of a channel in a chunk: when they were received [ns] and at what offsets they lie.

        Raises:
            InputError: more than `MAX_MESSAGES` in all.
        """
        self.total += len(received)
        if self.total > MAX_MESSAGES:
            raise InputError(f"over {MAX_MESSAGES} messages, expected fewer", file=self._path)
        chunks = np.full(len(received), chunk, np.int64)
        self._parts.setdefault(channel, []).append((received.astype(np.int64), chunks, offsets.astype(np.int64)))

    def channel(self, number: int, topic: str, kind: str, digest: str) -> Channel:
        """The channel of that number, with all that was added, in the order of the file."""
        parts = self._parts.get(number) or [(np.empty(0, np.int64),) * 3]
        received, chunks, offsets = (np.concatenate(column) for column in zip(*parts, strict=True))
        self._parts[number] = [(received, chunks, offsets)]  # more may follow: these are not put together again
        order = np.argsort(chunks, kind="stable")
        received, chunks, offsets = received[order], chunks[order], offsets[order]
        name = topic if topic.startswith("/") else f"/{topic}"
        return Channel(name, kind.replace("/msg/", "/"), digest, received, np.stack((chunks, offsets), axis=-1))


def name_of(data: bytes, path: Path, what: str) -> str:
    """A name of the file as text.

    Raises:
        InputError: too long, or not UTF-8.
    """
    if len(data) > MAX_NAME:
        raise InputError(f"{what} of {len(data)} bytes, expected at most {MAX_NAME}", file=path)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{what} is not UTF-8 text", file=path) from error
