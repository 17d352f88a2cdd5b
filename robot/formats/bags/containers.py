"""What the files of a bag have in common: channels, messages in the order of the file, and chunks, unpacked in bounds.

rosbags' own iterators sort by the time of reception, which mixes the runs of a recording whose clock was set back; so
its readers give headers, connections and indices, and the messages are taken from the chunks in file order. Sizes are
checked before anything is read; whatever a library raises becomes one line in `damage_in_one_line`.
"""

from __future__ import annotations

import bz2
import importlib
import shutil
import tempfile
import weakref
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple, Protocol

from moteslam.errors import InputError, MoteslamError

MAX_CHUNK = 256 << 20
"""Bytes of a chunk when it is unpacked. Recorders close one after about a megabyte, or a single larger message."""

MAX_MESSAGES = 20_000_000
"""No bag has more: an hour of twenty streams at 250 Hz."""

Place = tuple[int, int]
"""Where a message lies in its file: a chunk and an offset."""


class Channel(NamedTuple):
    """A topic of a file: its number there, name, type (``sensor_msgs/LaserScan``), MD5 of that (ROS 1), messages."""

    number: int
    topic: str
    kind: str
    digest: str
    total: int


class Message(NamedTuple):
    """A message: of which channel, when it was received [ns], where it lies, and its bytes."""

    channel: int
    received: int
    place: Place
    data: bytes


class Container(Protocol):
    """A file of messages; ``damage`` says what is missing of it, where it was cut short but can be read.

    ``temporary`` is a folder of unpacked files that is kept as long as this.
    """

    path: Path
    ros1: bool
    channels: list[Channel]
    damage: str | None
    temporary: TemporaryFolder | None

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """Those of some channels, in the order of the file."""

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
    except Exception as error:  # each library has exceptions of its own; a MemoryError is a size that is none
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"damaged: {text}", file=path) from error


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


class Chunked:
    """A file of chunks, of which the last is kept unpacked."""

    ros1 = False
    damage: str | None = None
    temporary: TemporaryFolder | None = None

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
        """See `Container`."""
        with damage_in_one_line(self.path), self.path.open("rb") as file:
            for place in places:
                yield self._payload(file, place)

    def _payload(self, file: IO[bytes], place: Place) -> bytes:
        raise NotImplementedError


class TemporaryFolder:
    """A folder that is there as long as this is."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="moteslam-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


def plain_kind(name: str) -> str:
    """A type's name without the ``msg`` of ROS 2."""
    return name.replace("/msg/", "/")
