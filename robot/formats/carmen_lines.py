"""The lines of a CARMEN log, parsed into flat arrays; what is broken is counted, not repaired.

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

import math
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from moteslam.robot.formats.lines import (
    BrokenLines,
    count_at,
    expect_stamp,
    expect_words,
    finite_numbers,
    numbers,
    parse_words,
    pose_of,
)

FLASER_TAIL = 9
"""Words after the ranges: two poses, ipc stamp, host, logger stamp."""

SHORT_TAILS = (6, 7)
"""The same in logs without the host and the logger's stamp, and without any stamp."""

ROBOTLASER_TAIL = 14
RAWLASER_TAIL = 3
ODOM_WORDS = 10

RAW_LASERS = tuple(f"RAWLASER{number}" for number in range(1, 6))
"""Scans without a pose, by the number of the laser."""

REAR_LASERS = ("RLASER", "ROBOTLASER2")
"""Scans of a laser that looks back: counted, not read."""

CLASSIC_STEPS = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Degrees between the beams of the lasers that classic logs are of, by the number of beams."""


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
        ranges: flat [n * beams] float32 [m].
        rows: flat [n * 8]: laser x y theta, robot x y theta [m, rad], ipc and logger stamp [s]. Poses of a line that
            states none are 0, and so are stamps.
        stated: the ``maximum_range`` of the first line [m], or None.
        first_line: number of the line it came from.
        numbers: flat [n]: of the lines of all.
    """

    first_line: int
    stated: float | None
    ranges: array[float] = field(default_factory=lambda: array("f"))
    rows: array[float] = field(default_factory=lambda: array("d"))
    numbers: array[int] = field(default_factory=lambda: array("q"))

    def __len__(self) -> int:
        return len(self.rows) // 8


@dataclass
class CarmenLines:
    """What a log says.

    Attributes:
        scans: by kind, in the order of appearance.
        odometry: flat [n * 5]: x y theta [m, rad], ipc and logger stamp [s].
        params: the numeric parameters, as stated last.
        broken: the laser and odometry lines that could not be used.
        rear: number of the scans of a laser that looks back, and of the first line, by the kind of line.
        flaser_tail: words after the ranges of the first FLASER line that has a known number of them, and so of all.
    """

    scans: dict[ScanKind, Scans] = field(default_factory=dict)
    odometry: array[float] = field(default_factory=lambda: array("d"))
    params: dict[str, float] = field(default_factory=dict)
    broken: BrokenLines = field(default_factory=BrokenLines)
    rear: dict[str, tuple[int, int]] = field(default_factory=dict)
    flaser_tail: int | None = None

    @property
    def used(self) -> int:
        """The number of lines that could be used."""
        return sum(map(len, self.scans.values())) + len(self.odometry) // 5


def parse_lines(lines: Iterable[bytes]) -> CarmenLines:
    """What the lines of a log say; comments and other kinds of line are passed over."""
    kinds: dict[str, Callable[[CarmenLines, Sequence[bytes], int], None]] = {
        "FLASER": _flaser,
        "ROBOTLASER1": _robotlaser,
        "ODOM": _odometry,
        "PARAM": _param,
        **dict.fromkeys(RAW_LASERS, _rawlaser),
        **dict.fromkeys(REAR_LASERS, _rear),
    }
    log = CarmenLines()
    log.broken = parse_words(lines, {kind.encode(): partial(parse, log) for kind, parse in kinds.items()})
    return log


def fov_of(beams: int) -> tuple[float, float]:
    """First angle and step [rad] of a FLASER line, which states neither: by the number of beams.

    180 and 181 beams are one degree apart, 360 and 361 half a degree; any other number spans 180 degrees. The first
    looks to -90 degrees.
    """
    step = CLASSIC_STEPS.get(beams, 180 / max(beams - 1, 1))
    return -math.pi / 2, math.radians(step)


def _flaser(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    count = count_at(words, 1, "ranges")
    found = len(words) - 2 - count
    tail = log.flaser_tail or (found if found in SHORT_TAILS else FLASER_TAIL)
    expect_words(words, 2 + count + tail, f"{count} ranges")
    after = words[2 + count :]
    row = [*pose_of(after[:6]), *_stamps(*(after[6:7] or (b"0",)), after[8] if tail == FLASER_TAIL else b"0")]
    _add(log, ScanKind("FLASER", count, *fov_of(count)), number, ranges=words[2 : 2 + count], row=row, stated=None)
    log.flaser_tail = tail


def _robotlaser(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    kind, ranges, tail, stated = _described(words, ROBOTLASER_TAIL)
    row = [*pose_of(tail[:6]), *_stamps(tail[11], tail[13])]
    _add(log, kind, number, ranges=ranges, row=row, stated=stated)


def _rawlaser(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    """Taken as long as no scan states a pose: logs that have such scans hold the same ranges there."""
    if any(kind.line not in RAW_LASERS for kind in log.scans):
        return
    kind, ranges, tail, stated = _described(words, RAWLASER_TAIL)
    _add(log, kind, number, ranges=ranges, row=[0.0] * 6 + _stamps(tail[0], tail[2]), stated=stated)


def _described(words: Sequence[bytes], tail: int) -> tuple[ScanKind, Sequence[bytes], Sequence[bytes], float | None]:
    """Kind, ranges, what comes after them, and limit [m] of a line that states its angles."""
    count = count_at(words, 8, "ranges")
    remissions = count_at(words, 9 + count, "remissions", least=0)
    expect_words(words, 10 + count + remissions + tail, f"{count} ranges and {remissions} remissions")
    angle_min, _, step, stated = finite_numbers(words[2:6])
    if step <= 0:
        raise ValueError(f"angular resolution {step}, expected more than 0 rad")
    kind = ScanKind(words[0].decode(), count, angle_min, step)
    return kind, words[9 : 9 + count], words[10 + count + remissions :], stated if stated > 0 else None


def _add(
    log: CarmenLines, kind: ScanKind, number: int, *, ranges: Sequence[bytes], row: list[float], stated: float | None
) -> None:
    values = array("f", numbers(ranges))
    if kind not in log.scans and kind.line not in RAW_LASERS:
        log.scans = {other: scans for other, scans in log.scans.items() if other.line not in RAW_LASERS}
    scans = log.scans.setdefault(kind, Scans(number, stated))
    scans.ranges.extend(values)
    scans.rows.extend(row)
    scans.numbers.append(number)


def _rear(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    count, first = log.rear.get(words[0].decode(), (0, number))
    log.rear[words[0].decode()] = (count + 1, first)


def _odometry(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    expect_words(words, ODOM_WORDS, "odometry")
    log.odometry.extend([*pose_of(words[1:4]), *_stamps(words[7], words[9])])


def _param(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    if len(words) > 2:
        try:
            log.params[words[1].decode("ascii", "replace")] = finite_numbers(words[2:3])[0]
        except ValueError:
            return  # most parameters of a robot are words


def _stamps(*words: bytes) -> list[float]:
    """The ipc and the logger stamp; the first that is not 0 is what counts, and must be one."""
    stamps = finite_numbers(words)
    expect_stamp(stamps[0] or stamps[1])
    return stamps
