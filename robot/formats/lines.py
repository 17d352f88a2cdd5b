"""Logs of a message a line, plain or gzip, read within bounds, up to any damage; broken lines are counted."""

from __future__ import annotations

import gzip
import zlib
from codecs import BOM_UTF8
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moteslam.errors import InputError
from moteslam.robot.files import open_regular
from moteslam.robot.formats.streams import MAX_DROPPED
from moteslam.robot.values import Issue, counted

MAX_TEXT = 1 << 30
"""No log may unpack to more than this: 1 GiB, about two days of a 180-beam laser at 5 Hz."""

MAX_LINE = 1 << 20
"""No line may be longer than this: 1 MiB, over 100 000 ranges."""

MAX_LINES = 20_000_000
"""No log may have more lines: a day and a half of odometry at 100 Hz, and the scans beside it."""

_CHUNK = 1 << 18


class TextLines:
    """The lines of a file, as bytes, without their ends; iterate once.

    A gzip file that ends early or is damaged gives the lines before the damage; ``damage`` describes it afterwards.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.damage = path, ""

    def __iter__(self) -> Iterator[bytes]:
        rest, size, count = b"", 0, 0
        for chunk in self._chunks():
            size += len(chunk)
            count += chunk.count(b"\n")
            *lines, rest = (rest + chunk).split(b"\n")
            if size > MAX_TEXT or count > MAX_LINES or len(rest) > MAX_LINE:
                problem = f"over {MAX_TEXT:,} bytes, {MAX_LINES:,} lines or {MAX_LINE:,} bytes a line, expected a log"
                raise InputError(problem, file=self.path)
            yield from lines
        if rest and not self.damage:
            yield rest

    def head(self) -> bytes:
        """What the file begins with, unpacked, 256 KiB or a little more; empty if nothing can be read."""
        start = b""
        try:
            for chunk in self._chunks():
                start += chunk
                if len(start) >= _CHUNK:
                    break
        except InputError:
            pass
        return start

    def _chunks(self) -> Iterator[bytes]:
        try:
            with open_regular(self.path, "a text file") as file:
                is_packed = file.read(2) == b"\x1f\x8b"
                file.seek(0)
                content: Any = gzip.GzipFile(fileobj=file) if is_packed else file
                yield content.read(len(BOM_UTF8)).removeprefix(BOM_UTF8)
                while chunk := content.read1(_CHUNK):
                    yield chunk
        except EOFError:
            self.damage = "the gzip data is cut short"
        except (zlib.error, gzip.BadGzipFile):
            self.damage = "the gzip data is damaged"
        except OSError as error:
            raise InputError(f"{error.strerror or error}, expected a text file", file=self.path) from error


@dataclass
class BrokenLines:
    """The lines that could not be used: how many, and the number of the first with what is wrong with it."""

    count: int = 0
    first: tuple[int, str] | None = None

    def add(self, number: int, problem: str) -> None:
        """Count a line by its number."""
        self.count += 1
        self.first = self.first or (number, problem)

    def issues(self, lines: TextLines, used: int, lacks: str, expected: str) -> list[Issue]:
        """The issues of a log that was read to its end: a damaged gzip, and lines that were dropped.

        Args:
            lines: of the log.
            used: how many could be.
            lacks, expected: what a log that holds none of it lacks, and what it should be.
        """
        path, damage, issues = lines.path, lines.damage, []
        number, problem = self.first or (None, f"{lacks}{f'; {damage}' if damage else ''}, {expected}")
        if not used:
            raise InputError(problem, file=path, line=number)
        if self.count > max(MAX_DROPPED, used // 10):
            raise InputError(f"{problem} (first of {self.count} broken lines, {used} whole)", file=path, line=number)
        if damage:
            issues.append(Issue("damaged-gzip", f"{path.name}: {damage}; what came before is used"))
        if self.count:
            text = f"{path.name}: {counted(self.count, 'broken line')} dropped, the first is line {number}: {problem}"
            issues.append(Issue("broken-lines", text, self.count))
        return issues
