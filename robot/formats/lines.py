"""Logs of a message a line, plain or gzip, read within bounds, up to any damage; broken lines are counted.

Those of CARMEN are parsed into flat arrays; what is broken is not repaired.

``FLASER n r1..rn laser(x y theta) robot(x y theta) ipc_timestamp host logger_timestamp``
``ROBOTLASER1 type angle_min fov increment range_max accuracy remission_mode n r1..rn m e1..em laser(x y theta)
robot(x y theta) tv rv forward_safety side_safety turn_axis ipc_timestamp host logger_timestamp``
``RAWLASER1 type angle_min fov increment range_max accuracy remission_mode n r1..rn m e1..em ipc_timestamp host
logger_timestamp``, and so to ``RAWLASER5``
``ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp``
``PARAM name value ...``

Source: the head that CARMEN's logger writes (carmen.sourceforge.net/logger_playback.html).
"""

from __future__ import annotations

import gzip
import math
import zlib
from array import array
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from moteslam.errors import InputError
from moteslam.robot.files import open_regular
from moteslam.robot.formats.streams import MAX_DROPPED, MAX_PLACE, MAX_STAMP
from moteslam.robot.formats.written import fov_of
from moteslam.robot.values import Issue, counted

MAX_TEXT = 1 << 30
"""No log may unpack to more than this: 1 GiB, about two days of a 180-beam laser at 5 Hz."""

MAX_LINE = 1 << 20
"""No line may be longer than this: 1 MiB, over 100 000 ranges."""

MAX_LINES = 20_000_000
"""No log may have more lines: a day and a half of odometry at 100 Hz, and the scans beside it."""

_CHUNK = 1 << 18

FLASER_TAIL, SHORT_TAILS = 9, (6, 7)
"""Words after the ranges: two poses, ipc stamp, host, logger stamp; in logs without stamps or without the logger's."""
RAW_LASERS = tuple(f"RAWLASER{number}" for number in range(1, 6))
"""Scans without a pose, by the number of the laser."""
REAR_LASERS = ("RLASER", "ROBOTLASER2")
"""Scans of a laser that looks back: counted, not read."""


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


class ScanKind(NamedTuple):
    """What the scans of one laser have in common: kind of line, number of beams, first angle and step [rad]."""

    line: str
    beams: int
    angle_min: float
    angle_increment: float


@dataclass
class Scans:
    """The scans of one kind.

    Attributes:
        stated: the ``maximum_range`` of the first line [m].
        ranges: flat [n * beams] float32 [m].
        rows: flat [n * 8]: laser x y theta, robot x y theta [m, rad], ipc and logger stamp [s]; 0 where not stated.
        numbers: flat [n]: of the lines.
        interlace: a scan measures every so manieth beam.
    """

    stated: float | None
    ranges: array[float] = field(default_factory=lambda: array("f"))
    rows: array[float] = field(default_factory=lambda: array("d"))
    numbers: array[int] = field(default_factory=lambda: array("q"))
    interlace: int = 1

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def most_others(self) -> int:
        """How many scans of other beams a log may have beside these."""
        return max(MAX_DROPPED, len(self) // 10)


class CarmenLines:
    """What the lines of a log say; comments and other kinds of line are passed over, broken ones counted.

    Attributes:
        scans: by kind, in the order of appearance.
        odometry: flat [n * 5]: x y theta [m, rad], ipc and logger stamp [s].
        params: the numeric parameters, as stated last.
        broken: the laser and odometry lines that could not be used.
        rear: number of the scans of a laser that looks back, by the kind of line.
        flaser_tail: words after the ranges of the first FLASER line that has a known number of them, and so of all.
    """

    def __init__(self, lines: TextLines) -> None:
        self.scans: dict[ScanKind, Scans] = {}
        self.odometry = array("d")
        self.params: dict[str, float] = {}
        self.broken = BrokenLines()
        self.rear: Counter[str] = Counter()
        self.flaser_tail = 0
        parsers = {"FLASER": self._flaser, "ROBOTLASER1": self._described, "ODOM": self._odom, "PARAM": self._param}
        parsers |= {**dict.fromkeys(RAW_LASERS, self._described), **dict.fromkeys(REAR_LASERS, self._rear)}
        known = {kind.encode(): parse for kind, parse in parsers.items()}
        starts = {kind[:1] for kind in known} | {b" ", b"\t"}
        for number, line in enumerate(lines, start=1):
            if line[:1] == b"\0":  # what a file system leaves of a log after a crash
                self.broken.add(number, "begins with NUL bytes, expected text")
            elif line[:1] in starts:  # most lines of other kinds are passed over without being split
                words = line.split()
                if words and (parse := known.get(words[0])):
                    try:
                        parse(words, number)
                    except (ValueError, OverflowError) as error:
                        self.broken.add(number, str(error))

    def _flaser(self, words: list[bytes], number: int) -> None:
        count = _count_at(words, 1, "ranges")
        found = len(words) - 2 - count
        tail = self.flaser_tail or (found if found in SHORT_TAILS else FLASER_TAIL)
        _expect_words(words, 2 + count + tail, f"{count} ranges")
        after = words[2 + count :]
        row = [*_pose(after[:6]), *_stamps(*(after[6:7] or (b"0",)), after[8] if tail == FLASER_TAIL else b"0")]
        self._add(ScanKind("FLASER", count, *fov_of(count)), number, words[2 : 2 + count], row, None)
        self.flaser_tail = tail

    def _described(self, words: list[bytes], number: int) -> None:
        """A line that states its angles.

        One without a pose is taken as long as no scan has one: logs that have such scans hold the same ranges there.
        """
        is_raw = words[0] != b"ROBOTLASER1"
        if is_raw and any(kind.line not in RAW_LASERS for kind in self.scans):
            return
        count = _count_at(words, 8, "ranges")
        remissions = _count_at(words, 9 + count, "remissions", least=0)
        after = 10 + count + remissions
        _expect_words(words, after + (3 if is_raw else 14), f"{count} ranges and {remissions} remissions")
        angle_min, _, step, stated = _numbers(words[2:6])
        if step <= 0:
            raise ValueError(f"angular resolution {step}, expected more than 0 rad")
        pose = [0.0] * 6 if is_raw else _pose(words[after : after + 6])
        row = [*pose, *_stamps(words[-3], words[-1])]
        kind = ScanKind(words[0].decode(), count, angle_min, step)
        self._add(kind, number, words[9 : 9 + count], row, stated if stated > 0 else None)

    def _add(self, kind: ScanKind, number: int, ranges: list[bytes], row: list[float], stated: float | None) -> None:
        values = array("f", _numbers(ranges, finite=False))
        if kind not in self.scans and kind.line not in RAW_LASERS:
            self.scans = {other: scans for other, scans in self.scans.items() if other.line not in RAW_LASERS}
        scans = self.scans.setdefault(kind, Scans(stated))
        scans.ranges.extend(values)
        scans.rows.extend(row)
        scans.numbers.append(number)

    def _rear(self, words: list[bytes], number: int) -> None:
        self.rear[words[0].decode()] += 1

    def _odom(self, words: list[bytes], number: int) -> None:
        _expect_words(words, 10, "odometry")
        self.odometry.extend([*_pose(words[1:4]), *_stamps(words[7], words[9])])

    def _param(self, words: list[bytes], number: int) -> None:
        if len(words) > 2:
            try:
                self.params[words[1].decode("ascii", "replace")] = _numbers(words[2:3])[0]
            except ValueError:
                return  # most parameters of a robot are words


def _expect_words(words: list[bytes], count: int, what: str) -> None:
    if len(words) != count:
        raise ValueError(f"{len(words)} words, expected {count} for {what}")


def _count_at(words: list[bytes], at: int, what: str, *, least: int = 1) -> int:
    """The number of things that a line declares in the word at an index."""
    if len(words) <= at or not words[at].isdigit() or int(words[at]) < least:
        found = words[at][:20].decode("ascii", "replace") if len(words) > at else f"{len(words)} words"
        raise ValueError(f"{found}, expected the number of {what} at word {at + 1}")
    return int(words[at])


def _pose(words: list[bytes]) -> list[float]:
    """Words as poses x y theta [m, rad], three a pose."""
    values = _numbers(words)
    if any(abs(value) > MAX_PLACE for value in values):
        raise ValueError(f"pose beyond {MAX_PLACE:.0f} m or rad, expected a robot's")
    return values


def _stamps(*words: bytes) -> list[float]:
    """The ipc and the logger stamp; the first that is not 0 is what counts, and must be one."""
    stamps = _numbers([*words])
    if abs(stamp := stamps[0] or stamps[1]) > MAX_STAMP:
        raise ValueError(f"stamp {stamp:.6g}, expected seconds below 1e11")
    return stamps


def _numbers(words: list[bytes], *, finite: bool = True) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise ValueError("a word that is no number, expected numbers") from None
    if finite and not all(map(math.isfinite, values)):
        raise ValueError("NaN or infinite pose or stamp, expected finite numbers")
    return values
