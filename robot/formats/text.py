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
from moteslam.robot.growing import GrowingFile
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


def begins_as_gzip(path: Path) -> bool:
    """Whether a file begins as one packed by gzip.

    Raises:
        InputError: it cannot be read.
    """
    with open_regular(path, "a text file") as file:
        return file.read(len(_GZIP)) == _GZIP


class LineSplitter:
    """Cuts the text of a file, as it comes, into lines, within bounds.

    Args:
        path: of the file, for messages.
        max_text, max_line: bytes of all text and of one line.

    Attributes:
        rest: what follows the end of the last line.
    """

    def __init__(self, path: Path, *, max_text: int = MAX_TEXT, max_line: int = MAX_LINE) -> None:
        self.rest = b""
        self._path, self._max_text, self._max_line = path, max_text, max_line
        self._bytes, self._lines = 0, 0

    def lines(self, chunk: bytes) -> list[bytes]:
        """The lines that end in the next part of the text, without their ends.

        Raises:
            InputError: a bound is passed.
        """
        self._bytes += len(chunk)
        if self._bytes > self._max_text:
            raise InputError(f"over {self._max_text} bytes of text, expected a log", file=self._path)
        self._lines += chunk.count(b"\n")
        if self._lines > MAX_LINES:
            raise InputError(f"over {MAX_LINES:,} lines, expected a log", file=self._path)
        *lines, self.rest = (self.rest + chunk).split(b"\n")
        if len(self.rest) > self._max_line:
            raise InputError(f"a line longer than {self._max_line} bytes, expected lines of text", file=self._path)
        return lines


class GrowingLines:
    """The lines of a plain text file that is still being written, as bytes, without their ends.

    Args:
        path: of the file.
        expected: what it should be, for messages.
    """

    def __init__(self, path: Path, expected: str) -> None:
        self.path = path
        self.damage: str | None = None
        self._file, self._splitter, self._begun = GrowingFile(path, expected), LineSplitter(path), False

    def new(self, *, last: bool) -> list[bytes]:
        """The lines that were finished since the last call.

        Args:
            last: nothing will follow: what stands behind the last end of a line is one, too.

        Raises:
            InputError: a bound is passed, or as `GrowingFile.opened`.
        """
        lines = [line for chunk in self._file.appended(_CHUNK) for line in self._splitter.lines(chunk)]
        if last and self._splitter.rest:
            lines.append(self._splitter.rest)
            self._splitter.rest = b""
        if lines and not self._begun:
            lines[0], self._begun = lines[0].removeprefix(BOM_UTF8), True
        return lines


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
        splitter = LineSplitter(self.path, max_text=self._max_text, max_line=self._max_line)
        for chunk in self._chunks():
            yield from splitter.lines(chunk)
        if splitter.rest and self.damage is None:
            yield splitter.rest

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
