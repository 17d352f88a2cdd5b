"""CARMEN logs, plain or gzip, finished or being written. Lines, rules and bounds: ``docs/reference/formats.md``."""

from __future__ import annotations

import re
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from moteslam.errors import InputError
from moteslam.robot.formats.carmen_lines import (
    RAW_LASERS,
    SHORT_TAILS,
    CarmenLines,
    CarmenParser,
    ScanKind,
    Scans,
    parse_lines,
)
from moteslam.robot.formats.carmen_writer import OWN_PARAMETERS, write_log
from moteslam.robot.formats.format import Format, Robot, one_sequence
from moteslam.robot.formats.interlaced import interlaced
from moteslam.robot.formats.logged_ranges import LoggedRanges
from moteslam.robot.formats.no_return import no_return_limit
from moteslam.robot.formats.streams import Fan, lidar_stream, mount_between, odometry_stream
from moteslam.robot.formats.text import GrowingLines, TextLines, begins_as_gzip
from moteslam.robot.formats.words import MAX_BROKEN, ReadLines, broken_issues
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import CARMEN
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.specs import LidarSpec
from moteslam.robot.wording import counted, first_complaint

_LINE = re.compile(rb"^(?:FLASER|ROBOTLASER1|RAWLASER[1-5]|ODOM|PARAM)\s", re.MULTILINE)
_LIMITS = ("robot_front_laser_max", "robot_frontlaser_max", "laser_front_max_range", "front_laser_max")


def is_carmen(path: Path) -> bool:
    """Whether a file, plain or gzip, begins like a CARMEN log: with a line of a known kind in its first 256 KiB."""
    return _LINE.search(TextLines(path).head()) is not None


def read_carmen(path: str | PathLike[str], *, platform: Platform | str | PathLike[str] | None = None) -> Recording:
    """Read a CARMEN log.

    Stamps are the ``ipc_timestamp``; the logger's where every ipc stamp of the log is 0. Broken lines are dropped
    and counted, as long as there are no more than 3 of them or a tenth of the log.

    Args:
        path: the log.
        platform: the robot, or a ``platform.toml`` whose keys override what the log gives.

    Returns:
        a recording with ``lidar`` (and in it the robot's odometry pose at every scan) and ``odometry``, each where
        the log has it; ``warnings`` lists what was dropped or repaired.

    Raises:
        InputError: not a CARMEN log, nothing usable in it, too much broken, or absurd stamps.
    """
    lines = TextLines(Path(path))
    log = parse_lines(lines)
    return _recording(lines, log, GivenRobot.read(platform), _ranges_of)


class CarmenFollower:
    """Reads a plain CARMEN log that is still being written; see `Follower`.

    Lines are parsed as they are finished, ranges cleaned as they are used. The streams are made anew at every poll:
    with 36 000 scans and 144 000 lines of odometry, an hour's, that costs 30 ms.

    Args:
        path: the log, which exists.
        platform: as of `read_carmen`.

    Raises:
        InputError: packed by gzip. Polled, also an interlaced lidar: its grid is known when the log is finished.
        ConfigError: a ``platform.toml`` that is none.
    """

    def __init__(self, path: Path, platform: Robot) -> None:
        if begins_as_gzip(path):
            problem = "packed by gzip, which cannot be read while it is written; expected a plain CARMEN log"
            raise InputError(problem, file=path)
        self._lines, self._parser = GrowingLines(path, "a CARMEN log"), CarmenParser()
        self._given = GivenRobot.read(platform)
        self._ranges: LoggedRanges | None = None

    def poll(self, *, last: bool = False) -> Recording | None:
        """See `Follower`."""
        lines = self._lines.new(last=last)
        self._parser.feed(lines)
        log = self._parser.log
        is_empty = not log.used and log.broken.count <= MAX_BROKEN
        if not last and (not lines or is_empty):
            return None
        return _recording(self._lines, log, self._given, self._kept_ranges)

    def _kept_ranges(self, chosen: _Chosen) -> LoggedRanges:
        if chosen.interlace > 1:
            problem = f"scans of an interlaced lidar, {chosen.interlace} in turns; expected a log that is finished"
            raise InputError(problem, file=self._lines.path, line=chosen.scans.first_line)
        if self._ranges is None or self._ranges.values is not chosen.scans.ranges:
            self._ranges = LoggedRanges(chosen.scans.ranges, chosen.kind.beams)
        return self._ranges


def _recording(
    lines: ReadLines,
    log: CarmenLines,
    given: GivenRobot,
    ranges_of: Callable[[_Chosen], NDArray[np.float32] | LoggedRanges],
) -> Recording:
    """The recording of a log that was parsed; ``ranges_of`` gives the ranges of its scans."""
    path = lines.path
    issues = broken_issues(lines, log.broken, log.used, "no FLASER, ROBOTLASER1 or ODOM line, expected a CARMEN log")
    chosen = _choose(path, log, issues)
    odometry = np.array(log.odometry, np.float64).reshape(-1, 5)
    rows = np.array(chosen.scans.rows if chosen else (), np.float64).reshape(-1, 8)
    if chosen and chosen.kind.line == "FLASER" and log.flaser_tail == min(SHORT_TAILS):
        rows[:, 6] = np.arange(len(rows))
        odometry = _without_stamps(path, odometry, issues)
    clock = -2 if (rows[:, 6] != 0).any() or (odometry[:, 3] != 0).any() else -1
    has_poses = chosen is not None and chosen.kind.line not in RAW_LASERS
    robot = given.over(_platform(path, log, rows if has_poses else rows[:0]))
    return Recording(
        name=re.sub(r"(\.log|\.clf)?(\.gz)?$", "", path.name) or path.name,
        platform=robot,
        lidar=chosen
        and _lidar(
            path,
            log,
            chosen,
            ranges=ranges_of(chosen),
            rows=rows,
            clock=clock,
            robot=robot,
            given=given,
            has_poses=has_poses,
            issues=issues,
        ),
        odometry=odometry_stream(path, "ODOM", odometry[:, clock], odometry[:, :3], issues),
        warnings=tuple(issues),
    )


def _without_stamps(path: Path, odometry: NDArray[np.float64], issues: list[Issue]) -> NDArray[np.float64]:
    """The odometry that can stand beside scans without stamps: none; the scans have their own poses."""
    issues.append(Issue("no-stamps", f"{path.name}: FLASER lines without stamps; one second a scan is assumed"))
    if len(odometry):
        text = f"{path.name}: {counted(len(odometry), 'ODOM line')} left aside, on another clock than the scans"
        issues.append(Issue("other-clock", text, len(odometry)))
    return odometry[:0]


class _Chosen(NamedTuple):
    """The scans that are read, what they have in common, and how they are interlaced; see `LidarStream`."""

    kind: ScanKind
    scans: Scans
    interlace: int
    kinds: frozenset[ScanKind]


def _choose(path: Path, log: CarmenLines, issues: list[Issue]) -> _Chosen | None:
    """The kind of scan most frequent in the log (of equals, the one that states its angles); others are left aside.

    Kinds that together are of one interlaced lidar count as one. Scans of a laser that looks back are left aside
    whatever their number.

    Raises:
        InputError: a tenth of the scans of that kind of line have other beams: the log is two.
    """
    for line, (count, first) in log.rear.items():
        text = f"{path.name}: {counted(count, f'{line} scan')} of a rear laser left aside, the first is line {first}"
        issues.append(Issue("other-scans", text, count))
    if not log.scans:
        return None
    lines = dict.fromkeys(kind.line for kind in log.scans)
    chosen = max((_of_line(log, line) for line in lines), key=lambda c: (len(c.scans), c.kind.line == "ROBOTLASER1"))
    kind, scans = chosen.kind, chosen.scans
    for other, left in log.scans.items():
        if other in chosen.kinds:
            continue
        text = f"{counted(len(left), f'{other.line} scan')} of {counted(other.beams, 'beam')}"
        if other.line == kind.line and len(left) > _most_others(scans):
            step = f" every {kind.angle_increment:.4f} rad" if chosen.interlace > 1 else ""
            raise InputError(
                f"{text} from {other.angle_min:.4f} rad, expected {kind.beams} beams{step} from {kind.angle_min:.4f} "
                f"rad as in the other {len(scans)}",
                file=path,
                line=left.first_line,
            )
        text = f"{path.name}: {text} left aside, the first is line {left.first_line}"
        issues.append(Issue("other-scans", text, len(left)))
    return chosen


def _of_line(log: CarmenLines, line: str) -> _Chosen:
    """The most frequent scans of a kind of line."""
    kinds = {kind: scans for kind, scans in log.scans.items() if kind.line == line}
    usual = max(kinds, key=lambda kind: len(kinds[kind]))
    found = interlaced(kinds, usual, _most_others(kinds[usual]))
    return _Chosen(*found) if found else _Chosen(usual, kinds[usual], 1, frozenset({usual}))


def _most_others(scans: Scans) -> int:
    """How many scans of other beams a log may have beside these."""
    return max(MAX_BROKEN, len(scans) // 10)


def _platform(path: Path, log: CarmenLines, rows: NDArray[np.float64]) -> Platform:
    """The built-in robot, with the size and the lidar's pose that the log gives.

    Raises:
        InputError: they are those of no robot.
    """
    size = {key: log.params[f"robot_{key}"] for key in ("length", "width") if log.params.get(f"robot_{key}", 0) > 0}
    try:
        return Platform(**{**CARMEN.model_dump(), **size, "lidar": _mount(log.params, rows)})
    except ValidationError as error:
        field, problem = first_complaint(error, "robot", lambda place: "")
        raise InputError(problem, file=path, field=f"PARAM {field}") from error


def _mount(params: dict[str, float], rows: NDArray[np.float64]) -> LidarSpec:
    """The lidar's pose on the robot: from parameters; else from logged poses, if they agree at every scan; else 0."""
    for prefix in ("robot_frontlaser", "frontlaser", "robot_front_laser", "front_laser"):
        if f"{prefix}_offset" in params:
            sideways, turned = (params.get(f"{prefix}_{key}_offset", 0.0) for key in ("side", "angular"))
            more = {field: params[name] for field, name in OWN_PARAMETERS.items() if name in params}
            return LidarSpec(x=params[f"{prefix}_offset"], y=sideways, yaw=turned, **more)
    return mount_between(rows[:, 3:6], rows[:, :3]) or LidarSpec()


def _lidar(
    path: Path,
    log: CarmenLines,
    chosen: _Chosen,
    *,
    ranges: NDArray[np.float32] | LoggedRanges,
    rows: NDArray[np.float64],
    clock: int,
    robot: Platform,
    given: GivenRobot,
    has_poses: bool,
    issues: list[Issue],
) -> LidarStream:
    """The scans; figures that a caller's ``platform.toml`` gives are taken in place of the log's."""
    kind, scans = chosen.kind, chosen.scans
    stated = next((log.params[key] for key in _LIMITS if log.params.get(key, 0) > 0), scans.stated)
    figures = given.lidar_figures
    range_max = figures.get("range_max") or (
        ranges.limit(stated)
        if isinstance(ranges, LoggedRanges)
        else no_return_limit(ranges if chosen.interlace == 1 else ranges[ranges > 0], stated)
    )
    return lidar_stream(
        path,
        kind.line,
        stamps=rows[:, clock],
        ranges=ranges,
        fan=Fan(kind.angle_min, kind.angle_increment, 0.0, range_max),
        robot=robot,
        given=figures,
        issues=issues,
        odometry=rows[:, 3:6] if has_poses else None,
        interlace=chosen.interlace,
    )


def _ranges_of(chosen: _Chosen) -> NDArray[np.float32]:
    return np.array(chosen.scans.ranges, np.float32).reshape(-1, chosen.kind.beams)


FORMAT = Format(
    "CARMEN log (FLASER, ROBOTLASER1, RAWLASER1, ODOM lines; plain or gzip)",
    is_folder=False,
    recognise=is_carmen,
    read=one_sequence("a CARMEN log", read_carmen),
    write=write_log,
    follow=CarmenFollower,
    endings=(".log", ".log.gz", ".clf", ".clf.gz"),
)
