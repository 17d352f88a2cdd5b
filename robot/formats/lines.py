"""Text of a message a line, plain or gzip, read within bounds, up to any damage; broken lines are counted."""

import gzip
import zlib
from codecs import BOM_UTF8
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from moteslam.errors import InputError
from moteslam.files import open_regular
from moteslam.robot.formats.streams import MAX_DROPPED
from moteslam.robot.values import Issue, counted

MAX_TEXT = 1 << 30  # Bytes of a log, unpacked: about two days of a 180-beam laser at 5 Hz
MAX_LINE = 1 << 20  # Bytes of a line: over 100 000 ranges
MAX_LINES = 20_000_000  # A day and a half of odometry at 100 Hz, and the scans beside it
HEAD = 1 << 18  # Bytes by which a format is known


class TextLines:
    """The lines of a file, as bytes, with their numbers from 1; iterate once.

    A gzip file that ends early or is damaged gives the lines before the damage. Lines that a reader cannot use it
    gives to `drop`; the issues of both are asked for at the end.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.damage = path, ""
        self.dropped = 0
        self.first: tuple[int, str] | None = None

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        size, number = 0, 0
        try:
            with open_regular(self.path, "a text file") as file:
                is_packed = file.read(2) == b"\x1f\x8b"
                file.seek(0)
                content: Any = gzip.GzipFile(fileobj=file) if is_packed else file
                while line := content.readline(MAX_LINE + 1):
                    size, number = size + len(line), number + 1
                    if size > MAX_TEXT or number > MAX_LINES or len(line) > MAX_LINE:
                        most = f"{MAX_TEXT:,} bytes, {MAX_LINES:,} lines or {MAX_LINE:,} bytes a line"
                        raise InputError(f"over {most}, expected a log", file=self.path)
                    yield number, line.removeprefix(BOM_UTF8) if number == 1 else line
        except EOFError:
            self.damage = "the gzip data is cut short"
        except (zlib.error, gzip.BadGzipFile):
            self.damage = "the gzip data is damaged"
        except OSError as error:
            raise InputError(f"{error.strerror or error}, expected a text file", file=self.path) from error

    def head(self) -> bytes:
        """The lines that the file begins with, 256 KiB or a little more; empty if nothing can be read."""
        start = bytearray()
        with suppress(InputError):
            for _, line in self:
                start += line
                if len(start) >= HEAD:
                    break
        return bytes(start)

    def drop(self, number: int, problem: str) -> None:
        self.dropped += 1
        self.first = self.first or (number, problem)

    def issues(self, used: int, missing: str) -> list[Issue]:
        """The issues of a log that was read to its end: a damaged gzip, and lines that were dropped.

        Args:
            used: how many lines could be.
            missing: what is wrong with a log without a line that could.
        """
        number, problem = self.first or (None, f"{self.damage}{'; ' if self.damage else ''}{missing}")
        if not used:
            raise InputError(problem, file=self.path, line=number)
        if self.dropped > max(MAX_DROPPED, used // 10):
            problem = f"{problem} (first of {self.dropped} broken lines, {used} whole)"
            raise InputError(problem, file=self.path, line=number)
        issues = []
        if self.damage:
            issues.append(Issue("damaged-gzip", f"{self.path.name}: {self.damage}; what came before is used"))
        if self.dropped:
            text = f"{counted(self.dropped, 'broken line')} dropped, the first is line {number}: {problem}"
            issues.append(Issue("broken-lines", f"{self.path.name}: {text}", self.dropped))
        return issues
