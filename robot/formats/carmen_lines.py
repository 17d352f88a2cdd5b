"""The lines of a CARMEN log, parsed into flat arrays; what is broken is counted, not repaired.

``FLASER n r1..rn laser(x y theta) robot(x y theta) ipc_timestamp host logger_timestamp``
``ROBOTLASER1 type angle_min fov increment range_max accuracy remission_mode n r1..rn m e1..em laser(x y theta)
robot(x y theta) tv rv forward_safety side_safety turn_axis ipc_timestamp host logger_timestamp``
``ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp``
``PARAM name value ...``
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from moteslam.robot.formats.bounds import MAX_PLACE
from moteslam.robot.formats.stamps import MAX_STAMP

FLASER_TAIL = 9
ROBOTLASER_TAIL = 14
ODOM_WORDS = 10

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
        rows: flat [n * 8]: laser x y theta, robot x y theta [m, rad], ipc and logger stamp [s].
        stated: the ``maximum_range`` of the first line [m], or None.
        first_line: number of the line it came from.
    """

    first_line: int
    stated: float | None
    ranges: array[float] = field(default_factory=lambda: array("f"))
    rows: array[float] = field(default_factory=lambda: array("d"))

    def __len__(self) -> int:
        return len(self.rows) // 8


@dataclass
class CarmenLines:
    """What a log says.

    Attributes:
        scans: by kind, in the order of appearance.
        odometry: flat [n * 5]: x y theta [m, rad], ipc and logger stamp [s].
        params: the numeric parameters, as stated last.
        broken: number of laser and odometry lines that could not be used.
        first_broken: number of the first of them and what is wrong with it.
    """

    scans: dict[ScanKind, Scans] = field(default_factory=dict)
    odometry: array[float] = field(default_factory=lambda: array("d"))
    params: dict[str, float] = field(default_factory=dict)
    broken: int = 0
    first_broken: tuple[int, str] | None = None

    @property
    def used(self) -> int:
        """The number of lines that could be used."""
        return sum(map(len, self.scans.values())) + len(self.odometry) // 5


def parse_lines(lines: Iterable[bytes]) -> CarmenLines:
    """Parse the lines of a log; comments and other kinds of line are passed over."""
    log = CarmenLines()
    parsers = {b"FLASER": _flaser, b"ROBOTLASER1": _robotlaser, b"ODOM": _odometry, b"PARAM": _param}
    starts = {kind[:1] for kind in parsers} | {b" ", b"\t"}
    for number, line in enumerate(lines, start=1):
        if line[:1] not in starts:  # most lines of other kinds are passed over without being split
            continue
        words = line.split()
        if words and (parse := parsers.get(words[0])):
            try:
                parse(log, words, number)
            except (ValueError, OverflowError) as error:
                log.broken += 1
                log.first_broken = log.first_broken or (number, str(error))
    return log


def fov_of(beams: int) -> tuple[float, float]:
    """First angle and step [rad] of a FLASER line, which states neither: by the number of beams.

    180 and 181 beams are one degree apart, 360 and 361 half a degree; any other number spans 180 degrees. The first
    looks to -90 degrees.
    """
    step = CLASSIC_STEPS.get(beams, 180 / max(beams - 1, 1))
    return -math.pi / 2, math.radians(step)


def _flaser(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    count = _count(words, 1, "ranges")
    _expect(words, 2 + count + FLASER_TAIL, f"{count} ranges")
    tail = words[2 + count :]
    row = [*_poses(tail[:6]), *_stamps(tail[6], tail[8])]
    _add(log, ScanKind("FLASER", count, *fov_of(count)), number, ranges=words[2 : 2 + count], row=row, stated=None)


def _robotlaser(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    count = _count(words, 8, "ranges")
    remissions = _count(words, 9 + count, "remissions", least=0)
    _expect(words, 10 + count + remissions + ROBOTLASER_TAIL, f"{count} ranges and {remissions} remissions")
    angle_min, _, step, stated = _finite(words[2:6])
    if step <= 0:
        raise ValueError(f"angular resolution {step}, expected more than 0 rad")
    tail = words[10 + count + remissions :]
    row = [*_poses(tail[:6]), *_stamps(tail[11], tail[13])]
    kind = ScanKind("ROBOTLASER1", count, angle_min, step)
    _add(log, kind, number, ranges=words[9 : 9 + count], row=row, stated=stated if stated > 0 else None)


def _add(
    log: CarmenLines, kind: ScanKind, number: int, *, ranges: Sequence[bytes], row: list[float], stated: float | None
) -> None:
    values = array("f", _numbers(ranges))
    scans = log.scans.setdefault(kind, Scans(number, stated))
    scans.ranges.extend(values)
    scans.rows.extend(row)


def _odometry(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    _expect(words, ODOM_WORDS, "odometry")
    log.odometry.extend([*_poses(words[1:4]), *_stamps(words[7], words[9])])


def _param(log: CarmenLines, words: Sequence[bytes], number: int) -> None:
    if len(words) > 2:
        try:
            log.params[words[1].decode("ascii", "replace")] = _finite(words[2:3])[0]
        except ValueError:
            return  # most parameters of a robot are words


def _count(words: Sequence[bytes], at: int, what: str, *, least: int = 1) -> int:
    if len(words) <= at:
        raise ValueError(f"{len(words)} words, expected the number of {what} at word {at + 1}")
    try:
        count = int(words[at])
    except ValueError:
        raise ValueError(f"no number of {what} at word {at + 1}") from None
    if count < least:
        raise ValueError(f"{count} {what}, expected at least {least}")
    return count


def _expect(words: Sequence[bytes], count: int, what: str) -> None:
    if len(words) != count:
        raise ValueError(f"{len(words)} words, expected {count} for {what}")


def _poses(words: Sequence[bytes]) -> list[float]:
    values = _finite(words)
    if any(abs(value) > MAX_PLACE for value in values):
        raise ValueError(f"pose beyond {MAX_PLACE:.0f} m or rad, expected a robot's")
    return values


def _stamps(*words: bytes) -> list[float]:
    """The ipc and the logger stamp; the first that is not 0 is what counts, and must be one."""
    stamps = _finite(words)
    used = stamps[0] or stamps[1]
    if abs(used) > MAX_STAMP:
        raise ValueError(f"stamp {used:.6g}, expected seconds below 1e11")
    return stamps


def _finite(words: Sequence[bytes]) -> list[float]:
    values = _numbers(words)
    if not all(map(math.isfinite, values)):
        raise ValueError("NaN or infinite pose or stamp, expected finite numbers")
    return values


def _numbers(words: Sequence[bytes]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ValueError("a word that is no number, expected numbers") from None
