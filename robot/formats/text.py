"""Lines of a text file, plain or gzip, that nobody vouches for: read in chunks, within bounds, up to any damage.

Gzip is unpacked here by zlib, a chunk at a time: ``gzip.open`` gives nothing of a file that is cut short, and does not
stop at a bound.
"""

from __future__ import annotations

import zlib
from codecs import BOM_UTF8
from collections.abc import Iterator
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.reading import open_regular

MAX_TEXT = 1 << 30
"""No log may unpack to more than this: 1 GiB, about two days of a 180-beam laser at 5 Hz."""

MAX_LINE = 1 << 20
"""No line may be longer than this: 1 MiB, over 100 000 ranges."""

MAX_LINES = 20_000_000
"""No log may have more lines: a day and a half of odometry at 100 Hz, and the scans beside it."""

_CHUNK = 1 << 18
_PACKED = 1 << 12  # gzip data are fed in small pieces: the piece in which they turn out damaged is lost
_GZIP = b"\x1f\x8b"


class TextLines:
    """The lines of a file, as bytes, without their ends; iterate once.

    A gzip file that ends early or is damaged gives the lines before the damage; ``damage`` describes it afterwards.

    Raises (on iteration):
        InputError: the file cannot be read, or passes a bound.
    """

    def __init__(self, path: Path, *, max_text: int = MAX_TEXT, max_line: int = MAX_LINE, chunk: int = _CHUNK) -> None:
        self.path = path
        self.damage: str | None = None
        self._max_text, self._max_line, self._chunk = max_text, max_line, chunk

    def __iter__(self) -> Iterator[bytes]:
        rest, total, lines_read = b"", 0, 0
        for chunk in self._chunks():
            total += len(chunk)
            if total > self._max_text:
                raise InputError(f"over {self._max_text} bytes of text, expected a log", file=self.path)
            lines_read += chunk.count(b"\n")
            if lines_read > MAX_LINES:
                raise InputError(f"over {MAX_LINES:,} lines, expected a log", file=self.path)
            *lines, rest = (rest + chunk).split(b"\n")
            if len(rest) > self._max_line:
                raise InputError(f"a line longer than {self._max_line} bytes, expected lines of text", file=self.path)
            yield from lines
        if rest and self.damage is None:
            yield rest

    def head(self) -> bytes:
        """What the file begins with, unpacked, a chunk (256 KiB) or a little more; empty if nothing can be read."""
        start = b""
        try:
            for chunk in self._chunks():
                start += chunk
                if len(start) >= self._chunk:
                    break
        except InputError:
            pass
        return start

    def _chunks(self) -> Iterator[bytes]:
        try:
            with open_regular(self.path, "a text file") as file:
                packed = file.read(2) == _GZIP
                file.seek(0)
                size = _PACKED if packed else self._chunk
                raw = iter(lambda: file.read(size), b"")
                chunks = self._unpacked(raw) if packed else raw
                yield next(chunks, b"").removeprefix(BOM_UTF8)
                yield from chunks
        except OSError as error:
            raise InputError(f"{error.strerror or error}, expected a text file", file=self.path) from error

    def _unpacked(self, raw: Iterator[bytes]) -> Iterator[bytes]:
        """Every member of a gzip file, never more than a chunk at a time."""
        member = zlib.decompressobj(wbits=31)
        begun = False
        for block in raw:
            while block:
                try:
                    chunk = member.decompress(block, self._chunk)
                except zlib.error:
                    self.damage = "the gzip data is damaged"
                    return
                begun = True
                if chunk:
                    yield chunk
                block = member.unconsumed_tail
                if member.eof:
                    block, begun = member.unused_data.lstrip(b"\0"), False
                    member = zlib.decompressobj(wbits=31)
        if begun:
            self.damage = "the gzip data is cut short"
