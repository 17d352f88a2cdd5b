"""Logs of one message a line, plain or gzip, that nobody vouches for: read within bounds, up to any damage.

What is broken is counted, not repaired: a parser of a kind of line raises ``ValueError`` with what is wrong.
"""

from __future__ import annotations

import gzip
import math
import zlib
from codecs import BOM_UTF8
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.files import open_regular
from moteslam.robot.formats.bounds import MAX_PLACE
from moteslam.robot.formats.stamps import MAX_STAMP
from moteslam.robot.values import Issue, counted

MAX_TEXT = 1 << 30
"""No log may unpack to more than this: 1 GiB, about two days of a 180-beam laser at 5 Hz."""

MAX_LINE = 1 << 20
"""No line may be longer than this: 1 MiB, over 100 000 ranges."""

MAX_LINES = 20_000_000
"""No log may have more lines: a day and a half of odometry at 100 Hz, and the scans beside it."""

MAX_BROKEN = 3
"""Up to this many broken lines are always dropped; more of them only up to a tenth of the log."""

_CHUNK = 1 << 18
_GZIP = b"\x1f\x8b"

Parser = Callable[[Sequence[bytes], int], None]
"""Takes the words of a line and its number from 1, and keeps what it says."""


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
        rest, size, count = b"", 0, 0
        for chunk in self._chunks():
            size += len(chunk)
            count += chunk.count(b"\n")
            *lines, rest = (rest + chunk).split(b"\n")
            if size > self._max_text:
                raise InputError(f"over {self._max_text} bytes of text, expected a log", file=self.path)
            if count > MAX_LINES:
                raise InputError(f"over {MAX_LINES:,} lines, expected a log", file=self.path)
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
                plain = iter(lambda: file.read(self._chunk), b"")
                chunks = self._unpacked(gzip.GzipFile(fileobj=file)) if packed else plain
                yield next(chunks, b"").removeprefix(BOM_UTF8)
                yield from chunks
        except OSError as error:
            raise InputError(f"{error.strerror or error}, expected a text file", file=self.path) from error

    def _unpacked(self, packed: gzip.GzipFile) -> Iterator[bytes]:
        """A gzip file by chunks, up to its damage."""
        try:
            while chunk := packed.read1(self._chunk):
                yield chunk
        except EOFError:
            self.damage = "the gzip data is cut short"
        except (zlib.error, gzip.BadGzipFile):
            self.damage = "the gzip data is damaged"


@dataclass
class BrokenLines:
    """The lines that could not be used: how many, and the number of the first with what is wrong with it."""

    count: int = 0
    first: tuple[int, str] | None = None

    def add(self, number: int, problem: str) -> None:
        """Count a line by its number."""
        self.count += 1
        self.first = self.first or (number, problem)


def parse_words(lines: Iterable[bytes], parsers: Mapping[bytes, Parser]) -> BrokenLines:
    """Give every line to the parser of its first word; comments and other kinds are passed over.

    Lines that begin with NUL bytes, what a file system leaves of a log after a crash, are broken.

    Returns:
        the lines that a parser refused.
    """
    broken = BrokenLines()
    starts = {kind[:1] for kind in parsers} | {b" ", b"\t", b"\0"}
    for number, line in enumerate(lines, start=1):
        if line[:1] not in starts:  # most lines of other kinds are passed over without being split
            continue
        if line[:1] == b"\0":
            broken.add(number, "begins with NUL bytes, expected text")
            continue
        words = line.split()
        if words and (parse := parsers.get(words[0])):
            try:
                parse(words, number)
            except (ValueError, OverflowError) as error:
                broken.add(number, str(error))
    return broken


def broken_issues(lines: TextLines, broken: BrokenLines, used: int, expected: str) -> list[Issue]:
    """The issues of a log that was read: a damaged gzip, and lines that were dropped.

    Args:
        lines: read to their end.
        broken: the lines that could not be used.
        used: how many could be.
        expected: what a log that holds none of it lacks, and what it should be: ``no ODOM line, expected a log``.

    Raises:
        InputError: nothing could be used, or more than 3 lines and a tenth of the log are broken.
    """
    path, damage = lines.path, lines.damage
    issues = []
    if damage is not None:
        issues.append(Issue("damaged-gzip", f"{path.name}: {damage}; what came before is used"))
    number, problem = broken.first or (None, "")
    if not used:
        if broken.first is None:
            lacks, _, wanted = expected.partition(", ")
            problem = f"{lacks}{f'; {damage}' if damage else ''}, {wanted}"
        raise InputError(problem, file=path, line=number)
    if broken.count > max(MAX_BROKEN, used // 10):
        raise InputError(f"{problem} (first of {broken.count} broken lines, {used} whole)", file=path, line=number)
    if broken.count:
        text = f"{path.name}: {counted(broken.count, 'broken line')} dropped, the first is line {number}: {problem}"
        issues.append(Issue("broken-lines", text, broken.count))
    return issues


def expect_words(words: Sequence[bytes], count: int, what: str) -> None:
    """Refuse a line of another number of words.

    Raises:
        ValueError: with both numbers.
    """
    if len(words) != count:
        raise ValueError(f"{len(words)} words, expected {count} for {what}")


def count_at(words: Sequence[bytes], at: int, what: str, *, least: int = 1) -> int:
    """The number of things that a line declares in the word at an index.

    Raises:
        ValueError: no such word, no whole number, or less than ``least``.
    """
    if len(words) <= at:
        raise ValueError(f"{len(words)} words, expected the number of {what} at word {at + 1}")
    try:
        count = int(words[at])
    except ValueError:
        raise ValueError(f"no number of {what} at word {at + 1}") from None
    if count < least:
        raise ValueError(f"{count} {what}, expected at least {least}")
    return count


def pose_of(words: Sequence[bytes]) -> list[float]:
    """Words as poses x y theta [m, rad], three a pose.

    Raises:
        ValueError: words that are no finite numbers, or poses beyond any robot's.
    """
    values = finite_numbers(words)
    if any(abs(value) > MAX_PLACE for value in values):
        raise ValueError(f"pose beyond {MAX_PLACE:.0f} m or rad, expected a robot's")
    return values


def expect_stamp(stamp: float) -> None:
    """Refuse what can be no stamp [s].

    Raises:
        ValueError: it is beyond 1e11 s.
    """
    if abs(stamp) > MAX_STAMP:
        raise ValueError(f"stamp {stamp:.6g}, expected seconds below 1e11")


def finite_numbers(words: Sequence[bytes]) -> list[float]:
    """Words as finite numbers.

    Raises:
        ValueError: one that is none.
    """
    values = numbers(words)
    if not all(map(math.isfinite, values)):
        raise ValueError("NaN or infinite pose or stamp, expected finite numbers")
    return values


def numbers(words: Sequence[bytes]) -> list[float]:
    """Words as numbers, NaN and infinite ones too.

    Raises:
        ValueError: one that is none.
    """
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ValueError("a word that is no number, expected numbers") from None
