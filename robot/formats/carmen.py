"""CARMEN logs, plain or gzip. Lines, rules and bounds: ``docs/reference/formats.md``."""

from __future__ import annotations

import re
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from moteslam.errors import InputError
from moteslam.robot.formats.carmen_lines import (
    CLASSIC_STEPS,
    RAW_LASERS,
    SHORT_TAILS,
    CarmenLines,
    ScanKind,
    Scans,
    parse_lines,
)
from moteslam.robot.formats.carmen_writer import OWN_PARAMETERS, write_log
from moteslam.robot.formats.format import Format, one_sequence
from moteslam.robot.formats.interlaced import interlaced
from moteslam.robot.formats.lines import MAX_BROKEN, TextLines, broken_issues
from moteslam.robot.formats.no_return import no_return_limit
from moteslam.robot.formats.streams import Fan, lidar_stream, mount_between, odometry_stream
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.platforms import CARMEN, GivenRobot
from moteslam.robot.recording import Recording
from moteslam.robot.tables import first_complaint
from moteslam.robot.values import Issue, counted

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
    path, given = lines.path, GivenRobot.read(platform)
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
    lidar = None
    if chosen is not None:
        kind, interlace = chosen.kind, chosen.interlace
        ranges = np.array(chosen.scans.ranges, np.float32).reshape(-1, kind.beams)
        lidar = lidar_stream(
            path,
            kind.line,
            stamps=rows[:, clock],
            ranges=ranges,
            fan=Fan(kind.angle_min, kind.angle_increment, 0.0, _range_max(log, chosen, ranges, given)),
            robot=robot,
            given=given.lidar_figures,
            issues=issues,
            odometry=rows[:, 3:6] if has_poses else None,
            interlace=interlace,
        )
        if kind.line == "FLASER" and kind.beams not in CLASSIC_STEPS and "angle_increment" not in given.lidar_figures:
            text = (
                f"{path.name}: FLASER lines state no angles: {kind.beams} beams are assumed to span 180 degrees. Of "
                "another lidar the map is wrong: give [lidar] angle_min and angle_increment by --platform"
            )
            issues.append(Issue("assumed-angles", text, len(lidar)))
    return Recording(
        name=re.sub(r"(\.log|\.clf)?(\.gz)?$", "", path.name) or path.name,
        platform=robot,
        lidar=lidar,
        odometry=odometry_stream(path, "ODOM", odometry[:, clock], odometry[:, :3], issues),
        warnings=tuple(issues),
    )


def _range_max(log: CarmenLines, chosen: _Chosen, ranges: NDArray[np.float32], given: GivenRobot) -> float:
    """From where on a range is no return [m]: as given, as the log states, or as its ranges show."""
    if given.lidar_figures.get("range_max"):
        return float(given.lidar_figures["range_max"])
    stated = next((log.params[key] for key in _LIMITS if log.params.get(key, 0) > 0), chosen.scans.stated)
    return no_return_limit(ranges if chosen.interlace == 1 else ranges[ranges > 0], stated)


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
        field, problem = first_complaint(error)
        raise InputError(problem, file=path, field=f"PARAM {field}") from error


def _mount(params: dict[str, float], rows: NDArray[np.float64]) -> LidarSpec:
    """The lidar's pose on the robot: from parameters; else from logged poses, if they agree at every scan; else 0."""
    for prefix in ("robot_frontlaser", "frontlaser", "robot_front_laser", "front_laser"):
        if f"{prefix}_offset" in params:
            sideways, turned = (params.get(f"{prefix}_{key}_offset", 0.0) for key in ("side", "angular"))
            more = {field: params[name] for field, name in OWN_PARAMETERS.items() if name in params}
            return LidarSpec(x=params[f"{prefix}_offset"], y=sideways, yaw=turned, **more)
    return mount_between(rows[:, 3:6], rows[:, :3]) or LidarSpec()


FORMAT = Format(
    "CARMEN log (FLASER, ROBOTLASER1, RAWLASER1, ODOM lines; plain or gzip)",
    is_folder=False,
    recognise=is_carmen,
    read=one_sequence("a CARMEN log", read_carmen),
    write=write_log,
    endings=(".log", ".log.gz", ".clf", ".clf.gz"),
)
