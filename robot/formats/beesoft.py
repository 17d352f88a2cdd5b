"""Logs of the robots of Bonn, Freiburg and CMU before CARMEN, as Radish has them: script logs and rec logs.

A script log states the time in a line of its own before each message::

    @SENS 12-03-99 14:05:01.250000
    #ROBOT x y angle
    #LASER n m: r1..rn q1..qm

n ranges of the front laser, m of the rear one, which are left aside. A rec log has them in one line::

    POS seconds microseconds: x y heading tv rv
    LASER-RANGE seconds microseconds laser n fov: r1..rn

Centimetres and degrees; ranges from right to left as in a ``FLASER`` line of a CARMEN log. The ``angle`` of a script
log is 90 less the heading. Source: BeeSoft and CARMEN's logtools, which write both.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.robot.formats.format import Format, Robot, one_sequence
from moteslam.robot.formats.no_return import no_return_limit
from moteslam.robot.formats.streams import Fan, lidar_stream, odometry_stream
from moteslam.robot.formats.text import TextLines
from moteslam.robot.formats.words import (
    are_numbers,
    begins_with,
    broken_issues,
    count_at,
    expect_stamp,
    expect_words,
    finite_numbers,
    numbers,
    parse_words,
    pose_of,
)
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.wording import counted

CENTIMETRE = 0.01
MICRO = 1e-6
FRONT = 0
"""The number of the front laser in a rec log."""

CENTURY = 70
"""Years of two digits from here on are of the twentieth century."""

ROBOT = Platform(name="beesoft")
"""A robot of which a log states nothing: odometry poses and a lidar at its centre."""


@dataclass
class _Log:
    """What a log says: flat [n * 4] poses and stamps [m, rad, s], flat [k * beams] ranges [m] and their stamps [s]."""

    poses: array[float] = field(default_factory=lambda: array("d"))
    stamps: array[float] = field(default_factory=lambda: array("d"))
    ranges: array[float] = field(default_factory=lambda: array("f"))
    fan: tuple[int, float] | None = None
    rear: int = 0
    now: float | None = None

    def time(self, words: Sequence[bytes], number: int) -> None:
        """``@SENS``: the time of the message that follows."""
        self.now = None
        expect_words(words, 3, "a date and a time")
        self.now = _seconds(words[1], words[2])

    def script_pose(self, words: Sequence[bytes], number: int) -> None:
        """``#ROBOT``: a pose, by the angle of BeeSoft."""
        expect_words(words, 4, "a pose")
        x, y, angle = finite_numbers(words[1:4])
        self._pose(x, y, 90.0 - angle, self._stamp())

    def script_scan(self, words: Sequence[bytes], number: int) -> None:
        """``#LASER``: a scan of both lasers."""
        front = count_at(words, 1, "front ranges", least=0)
        rear = count_at([words[0], words[2].rstrip(b":")] if len(words) > 2 else words, 1, "rear ranges", least=0)
        expect_words(words, 3 + front + rear, f"{front} front and {rear} rear ranges")
        stamp = self._stamp()
        self.rear += rear > 0
        if front:
            self._scan(words[3 : 3 + front], 180.0, stamp)

    def rec_pose(self, words: Sequence[bytes], number: int) -> None:
        """``POS``: a pose, with its time; velocities may be left out."""
        if len(words) not in (6, 8):
            raise ValueError(f"{len(words)} words, expected 6 or 8 for a pose")
        x, y, heading = finite_numbers(words[3:6])
        self._pose(x, y, heading, _joined(words))

    def rec_scan(self, words: Sequence[bytes], number: int) -> None:
        """``LASER-RANGE``: a scan, with its time and field of view."""
        count = count_at(words, 4, "ranges")
        expect_words(words, 6 + count, f"{count} ranges")
        laser = count_at(words, 3, "lasers", least=FRONT)
        (view,) = finite_numbers([words[5].rstrip(b":")])
        if not 0 < view <= 360:
            raise ValueError(f"field of view {view:g}, expected degrees above 0 and up to 360")
        stamp = _joined(words)
        if laser != FRONT:
            self.rear += 1
            return
        self._scan(words[6:], view, stamp)

    def _stamp(self) -> float:
        if self.now is None:
            raise ValueError("a message without a time, expected an @SENS line before it")
        stamp, self.now = self.now, None
        return stamp

    def _pose(self, x: float, y: float, degrees: float, stamp: float) -> None:
        words = [repr(value).encode() for value in (x, y, math.radians(degrees))]
        self.poses.extend([*pose_of(words, metres=CENTIMETRE), stamp])

    def _scan(self, words: Sequence[bytes], view: float, stamp: float) -> None:
        fan = (len(words), view)
        if fan != (self.fan or fan):
            raise ValueError(f"{fan[0]} ranges over {view:g} degrees, expected {self.fan} as in the scans before it")
        self.ranges.extend(array("f", [value * CENTIMETRE for value in numbers(words)]))
        self.stamps.append(stamp)
        self.fan = fan


def _seconds(date: bytes, time: bytes) -> float:
    """The seconds of ``12-03-99`` and ``14:05:01.25``, taken for UTC.

    Writers count months from 0 or from 1, and their days go to 31 in every month: only differences have a meaning.
    """
    try:
        day, month, year = (int(part) for part in date.split(b"-"))
        hour, minute, second = time.split(b":")
        year += 2000 if year < CENTURY else 1900 if year < 1000 else 0  # C counts years from 1900: 103 is 2003
        begin = datetime(year, max(month, 1), 1, int(hour), int(minute), tzinfo=UTC)
        seconds = (begin + timedelta(days=day - 1)).timestamp() + float(second)
    except (ValueError, OverflowError):
        raise ValueError("no date and time, expected day-month-year hour:minute:second") from None
    return expect_stamp(finite_numbers([repr(seconds).encode()])[0])


def _joined(words: Sequence[bytes]) -> float:
    """The stamp of the seconds and microseconds in the words after the first."""
    seconds, micro = finite_numbers([words[1], words[2].rstrip(b":")])
    return expect_stamp(seconds + micro * MICRO)


def is_beesoft(path: Path) -> bool:
    """Whether a file, plain or gzip, begins like a script log or a rec log."""
    head = TextLines(path).head()
    return head.lstrip().startswith((b"@OPEN ", b"@SENS ")) or begins_with(path, _is_entry, lines=2)


def _is_entry(words: Sequence[bytes]) -> bool:
    colon = {b"POS": 2, b"LASER-RANGE": 5}.get(words[0], 0)
    return bool(colon) and len(words) > colon and words[colon].endswith(b":") and are_numbers(words[1:colon])


def read_beesoft(path: str | PathLike[str], *, platform: Robot = None) -> Recording:
    """Read a script log or a rec log.

    No return is found as in a CARMEN log that states no limit. Broken lines are dropped and counted, as long as there
    are no more than 3 of them or a tenth of the log.

    Args:
        path: the log.
        platform: the robot, or a ``platform.toml`` whose keys override what is known of it.

    Returns:
        a recording with ``lidar`` and ``odometry``, each where the log has it.

    Raises:
        InputError: nothing usable in it, too much broken, or absurd stamps.
    """
    path = Path(path)
    log = _Log()
    lines = TextLines(path)
    parsers = {
        b"@SENS": log.time,
        b"#ROBOT": log.script_pose,
        b"#LASER": log.script_scan,
        b"POS": log.rec_pose,
        b"LASER-RANGE": log.rec_scan,
    }
    broken = parse_words(lines, parsers)
    poses = np.array(log.poses, np.float64).reshape(-1, 4)
    used = len(poses) + len(log.stamps)
    issues = broken_issues(lines, broken, used, "no pose and no scan, expected a script log or a rec log")
    if log.rear:
        text = f"{path.name}: {counted(log.rear, 'scan')} of another laser than the front one left aside"
        issues.append(Issue("other-scans", text, log.rear))
    given = GivenRobot.read(platform)
    robot = given.over(ROBOT)
    return Recording(
        name=path.name.removesuffix(".gz").rpartition(".")[0] or path.name,
        platform=robot,
        lidar=_lidar(path, log, robot, given, issues),
        odometry=odometry_stream(path, "poses", poses[:, 3], poses[:, :3], issues),
        warnings=tuple(issues),
    )


def _lidar(path: Path, log: _Log, robot: Platform, given: GivenRobot, issues: list[Issue]) -> LidarStream | None:
    if log.fan is None:
        return None
    beams, view = log.fan
    ranges = np.array(log.ranges, np.float32).reshape(-1, beams)
    figures = given.lidar_figures
    range_max = figures.get("range_max") or no_return_limit(ranges, None)
    step = math.radians(view) / max(beams - beams % 2, 1)  # 180 beams over 180 degrees are one apart, and so are 181
    return lidar_stream(
        path,
        "scans",
        stamps=np.array(log.stamps, np.float64),
        ranges=ranges,
        fan=Fan(-math.radians(view) / 2, step, 0.0, range_max),
        robot=robot,
        given=figures,
        issues=issues,
    )


FORMAT = Format(
    "script or rec log (#ROBOT and #LASER, or POS and LASER-RANGE lines)",
    is_folder=False,
    recognise=is_beesoft,
    read=one_sequence("a script or rec log", read_beesoft),
)
