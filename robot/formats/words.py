"""Logs of one message a line, its words apart by blanks: parsed line by line, what is broken is counted, not repaired.

A parser of a kind of line raises ``ValueError`` with what is wrong; the words below do it for numbers, counts, poses
and stamps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from moteslam.errors import InputError
from moteslam.robot.formats.bounds import MAX_PLACE
from moteslam.robot.formats.stamps import MAX_STAMP
from moteslam.robot.formats.text import TextLines
from moteslam.robot.issues import Issue
from moteslam.robot.wording import counted

MAX_BROKEN = 3
"""Up to this many broken lines are always dropped; more of them only up to a tenth of the log."""

HEAD = 1 << 16
"""Bytes by which a kind of log is known: a folder may hold many files that are none."""

Parser = Callable[[Sequence[bytes], int], None]
"""Takes the words of a line and its number from 1, and keeps what it says."""


@dataclass
class BrokenLines:
    """The lines that could not be used.

    Attributes:
        count: how many.
        first: number of the first of them and what is wrong with it.
    """

    count: int = 0
    first: tuple[int, str] | None = None

    def add(self, number: int, problem: str) -> None:
        """Count a line by its number."""
        self.count += 1
        self.first = self.first or (number, problem)


class WordParser:
    """Gives every line of a known kind to its parser; comments and other kinds are passed over.

    Lines that begin with NUL bytes, what a file system leaves of a log after a crash, are broken.

    Args:
        parsers: by the first word of the lines that they take.

    Attributes:
        broken: the lines that a parser refused.
    """

    def __init__(self, parsers: Mapping[bytes, Parser]) -> None:
        self.broken = BrokenLines()
        self._parsers, self._lines = parsers, 0
        self._starts = {kind[:1] for kind in parsers} | {b" ", b"\t", b"\0"}

    def feed(self, lines: Iterable[bytes]) -> None:
        """Parse the lines that follow."""
        number, before = self._lines, self._lines
        for number, line in enumerate(lines, start=before + 1):
            if line[:1] not in self._starts:  # most lines of other kinds are passed over without being split
                continue
            if line[:1] == b"\0":
                self.broken.add(number, "begins with NUL bytes, expected text")
                continue
            words = line.split()
            if words and (parse := self._parsers.get(words[0])):
                _parse(parse, words, number, self.broken)
        self._lines = number


def parse_words(lines: Iterable[bytes], parsers: Mapping[bytes, Parser]) -> BrokenLines:
    """Parse the lines of a log by a `WordParser`; the lines that were refused."""
    parser = WordParser(parsers)
    parser.feed(lines)
    return parser.broken


def parse_rows(lines: Iterable[bytes], parse: Parser) -> BrokenLines:
    """Give every line that is neither empty nor a comment (``#``) to one parser; as ``parse_words``."""
    broken = BrokenLines()
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if words and not words[0].startswith(b"#"):
            _parse(parse, words, number, broken)
    return broken


def _parse(parse: Parser, words: Sequence[bytes], number: int, broken: BrokenLines) -> None:
    try:
        parse(words, number)
    except (ValueError, OverflowError) as error:
        broken.add(number, str(error))


class ReadLines(Protocol):
    """Lines of a file that were read: of which, and what is damaged of it, None if nothing is."""

    path: Path
    damage: str | None


def broken_issues(lines: ReadLines, broken: BrokenLines, used: int, expected: str) -> list[Issue]:
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


def whole_numbers(words: Sequence[bytes], what: str, *, below: int) -> list[int]:
    """Words as whole numbers.

    Raises:
        ValueError: one that is none, or not below ``below`` in size.
    """
    try:
        values = [int(word) for word in words]
    except ValueError:
        raise ValueError(f"a word that is no whole number, expected {what}") from None
    if any(abs(value) >= below for value in values):
        raise ValueError(f"{what} beyond {below}, expected those of a robot")
    return values


def pose_of(words: Sequence[bytes], *, metres: float = 1.0) -> list[float]:
    """Words as poses x y theta [m, rad].

    Args:
        words: three a pose.
        metres: unit of x and y in the log [m].

    Raises:
        ValueError: words that are no finite numbers, or poses beyond any robot's.
    """
    values = finite_numbers(words)
    if metres != 1.0:
        values = [value if place % 3 == 2 else value * metres for place, value in enumerate(values)]
    if any(abs(value) > MAX_PLACE for value in values):
        raise ValueError(f"pose beyond {MAX_PLACE:.0f} m or rad, expected a robot's")
    return values


def expect_stamp(stamp: float) -> float:
    """A stamp [s] that can be one.

    Raises:
        ValueError: it is beyond 1e11 s.
    """
    if abs(stamp) > MAX_STAMP:
        raise ValueError(f"stamp {stamp:.6g}, expected seconds below 1e11")
    return stamp


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


def begins_with(path: Path, are: Callable[[Sequence[bytes]], bool], *, lines: int = 3) -> bool:
    """Whether the first whole lines of a file, comments and empty ones left out, are all of a kind.

    Args:
        path: of the file, plain or gzip.
        are: whether the words of a line are; must not raise.
        lines: how many are looked at; of a shorter file all, at least one.
    """
    head = TextLines(path, chunk=HEAD).head()
    whole = head[: head.rfind(b"\n") + 1] or head
    split = (line.split() for line in whole.split(b"\n"))
    first = [words for words in split if words and not words[0].startswith(b"#")][:lines]
    return bool(first) and all(map(are, first))


def are_numbers(words: Sequence[bytes]) -> bool:
    """Whether all words are numbers."""
    try:
        numbers(words)
    except ValueError:
        return False
    return True
