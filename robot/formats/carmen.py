"""CARMEN logs, plain or gzip. Lines, rules and bounds: ``docs/reference/formats.md``."""

from __future__ import annotations

import re
from array import array
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats import Format, Robot, expect_no_sequence
from moteslam.robot.formats.lines import RAW_LASERS, SHORT_TAILS, CarmenLines, ScanKind, Scans, TextLines
from moteslam.robot.formats.streams import (
    Fan,
    lidar_stream,
    no_return_limit,
    odometry_stream,
)
from moteslam.robot.formats.written import CLASSIC_STEPS, OWN_PARAMETERS, write_carmen
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import CARMEN, GivenRobot, platform_of
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue, counted

MAX_INTERLACE = 8
"""Bearings of the grid in a step between beams, at most; a SICK LMS has 2 or 4."""
SAME_ANGLE = 1e-4
"""First angles are taken for those of the grid when they are this near [rad]; logs have six digits."""
_LINE = re.compile(rb"^(?:FLASER|ROBOTLASER1|RAWLASER[1-5]|ODOM|PARAM)\s", re.MULTILINE)
_LIMITS = ("robot_front_laser_max", "robot_frontlaser_max", "laser_front_max_range", "front_laser_max")
_SAME = 0.005


def is_carmen(path: Path) -> bool:
    """Whether a file, plain or gzip, begins like a CARMEN log: with a line of a known kind in its first 256 KiB."""
    return _LINE.search(TextLines(path).head()) is not None


def read_carmen(path: str | PathLike[str], sequence: str | int | None = None, platform: Robot = None) -> Recording:
    """Read a CARMEN log; its stamps are the ``ipc_timestamp``, the logger's where every ipc stamp is 0."""
    expect_no_sequence(path, sequence)
    path, given = Path(path), GivenRobot.read(platform)
    lines = TextLines(path)
    log = CarmenLines(lines)
    used = sum(map(len, log.scans.values())) + len(log.odometry) // 5
    issues = log.broken.issues(lines, used, "no FLASER, ROBOTLASER1 or ODOM line", "expected a CARMEN log")
    kind, scans = _chosen(path, log, issues) if log.scans or log.rear else (None, None)
    odometry = np.array(log.odometry, np.float64).reshape(-1, 5)
    rows = np.array(scans.rows if scans else (), np.float64).reshape(-1, 8)
    if kind and kind.line == "FLASER" and log.flaser_tail == min(SHORT_TAILS):
        rows[:, 6] = np.arange(len(rows))
        issues.append(Issue("no-stamps", f"{path.name}: FLASER lines without stamps; one second a scan is assumed"))
        if len(odometry):
            text = f"{path.name}: {counted(len(odometry), 'ODOM line')} left aside, on another clock than the scans"
            issues.append(Issue("other-clock", text, len(odometry)))
        odometry = odometry[:0]
    clock = -2 if (rows[:, 6] != 0).any() or (odometry[:, 3] != 0).any() else -1
    has_poses = kind is not None and kind.line not in RAW_LASERS
    robot = given.over(_platform(path, log, rows if has_poses else rows[:0]))
    lidar = None
    if kind is not None and scans is not None:
        ranges = np.array(scans.ranges, np.float32).reshape(-1, kind.beams)
        if not (limit := given.lidar_figures.get("range_max")):
            stated = next((log.params[key] for key in _LIMITS if log.params.get(key, 0) > 0), scans.stated)
            limit = no_return_limit(ranges if scans.interlace == 1 else ranges[ranges > 0], stated)
        lidar = lidar_stream(
            path,
            kind.line,
            stamps=rows[:, clock],
            ranges=ranges,
            fan=Fan(kind.angle_min, kind.angle_increment, 0.0, float(limit)),
            robot=robot,
            given=given.lidar_figures,
            issues=issues,
            odometry=rows[:, 3:6] if has_poses else None,
            interlace=scans.interlace,
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


def _chosen(path: Path, log: CarmenLines, issues: list[Issue]) -> tuple[ScanKind, Scans] | tuple[None, None]:
    """The kind of scan most frequent in the log (of equals, the one that states its angles); others are left aside.

    Kinds that together are of one interlaced lidar count as one. Scans of a laser that looks back are left aside
    whatever their number.
    """
    for line, count in log.rear.items():
        text = f"{path.name}: {counted(count, f'{line} scan')} of a rear laser left aside"
        issues.append(Issue("other-scans", text, count))
    usual: dict[str, ScanKind] = {}
    for kind in sorted(log.scans, key=lambda kind: -len(log.scans[kind])):
        usual.setdefault(kind.line, kind)
    found = [
        _interlaced(log.scans, kind) for line in dict.fromkeys(kind.line for kind in log.scans) if (kind := usual[line])
    ]
    if not found:
        return None, None
    kind, scans, kinds = max(found, key=lambda one: (len(one[1]), one[0].line == "ROBOTLASER1"))
    for other, left in log.scans.items():
        if other in kinds:
            continue
        text = f"{counted(len(left), f'{other.line} scan')} of {counted(other.beams, 'beam')}"
        if other.line == kind.line and len(left) > scans.most_others:
            problem = f"{text} every {other.angle_increment:.4f} rad from {other.angle_min:.4f} rad, expected "
            problem += f"{kind.beams} beams every {kind.angle_increment:.4f} rad from {kind.angle_min:.4f} rad as in "
            raise InputError(f"{problem}the other {len(scans)}", file=path, line=left.numbers[0])
        text = f"{path.name}: {text} left aside, the first is line {left.numbers[0]}"
        issues.append(Issue("other-scans", text, len(left)))
    return kind, scans


def _interlaced(log: dict[ScanKind, Scans], usual: ScanKind) -> tuple[ScanKind, Scans, set[ScanKind]]:
    """The scans of a kind of line: of the usual kind or, of an interlaced lidar, of several on one grid of bearings.

    A SICK LMS that measures every degree can begin each scan at another quarter or half of one, so that several scans
    together are four or two times as dense. Its log has that many kinds of scan in turns, which begin at different
    bearings of one grid, less than a step apart, and are otherwise alike: step, limit, and number of beams, give or
    take the one at the end.
    """
    most_others = log[usual].most_others
    alike = [
        kind
        for kind in log
        if kind.line == usual.line
        and log[kind].stated == log[usual].stated
        and abs(kind.beams - usual.beams) <= 1
        and abs(kind.angle_min - usual.angle_min) < usual.angle_increment - SAME_ANGLE
        and abs(kind.angle_increment - usual.angle_increment) * usual.beams < SAME_ANGLE
    ]
    frequent = [kind for kind in alike if kind == usual or len(log[kind]) > most_others]
    if sum(len(log[kind]) for kind in alike if kind != usual) > most_others:
        for kinds in (alike, frequent):
            first = min(kind.angle_min for kind in kinds)
            for interlace in range(2, MAX_INTERLACE + 1) if len(kinds) > 1 else ():
                step = usual.angle_increment / interlace
                off = np.array([(kind.angle_min - first) / step for kind in kinds])
                begins = np.rint(off).astype(int).tolist()
                is_grid = (np.abs(off - begins) * step < SAME_ANGLE).all() and max(begins) < interlace
                if is_grid and len(set(begins)) == len(kinds):
                    merged, beams = _merged(log, dict(zip(kinds, begins, strict=True)), interlace)
                    return ScanKind(usual.line, beams, first, step), merged, {*kinds}
    return usual, log[usual], {usual}


def _merged(log: dict[ScanKind, Scans], begins: dict[ScanKind, int], interlace: int) -> tuple[Scans, int]:
    """The scans of some kinds, which begin at these beams of a grid, in the order of the file; and the grid's beams.

    The range is 0, which says nothing, at the beams that a scan does not measure.
    """
    beams = max(begin + interlace * (kind.beams - 1) + 1 for kind, begin in begins.items())
    numbers = np.concatenate([np.array(log[kind].numbers, np.int64) for kind in begins])
    ranges = np.zeros((len(numbers), beams), np.float32)
    done = 0
    for kind, begin in begins.items():
        columns = begin + interlace * np.arange(kind.beams)
        ranges[done : done + len(log[kind]), columns] = np.array(log[kind].ranges).reshape(-1, kind.beams)
        done += len(log[kind])
    order = np.argsort(numbers)
    rows = np.concatenate([np.array(log[kind].rows).reshape(-1, 8) for kind in begins])[order]
    flat = array("f", ranges[order].tobytes()), array("d", rows.tobytes()), array("q", np.sort(numbers).tobytes())
    return Scans(next(log[kind].stated for kind in begins), *flat, interlace=interlace), beams


def _platform(path: Path, log: CarmenLines, rows: NDArray[np.float64]) -> Platform:
    """The built-in robot, with the size and the lidar's pose that the log gives."""
    size = {key: log.params[f"robot_{key}"] for key in ("length", "width") if log.params.get(f"robot_{key}", 0) > 0}
    return platform_of({"name": CARMEN.name, **size, "lidar": _mount(log.params, rows)}, file=path)


def _mount(params: dict[str, float], rows: NDArray[np.float64]) -> dict[str, float]:
    """The lidar's pose on the robot: from parameters; else from logged poses, where 99 % of them agree; else 0."""
    for prefix in ("robot_frontlaser", "frontlaser", "robot_front_laser", "front_laser"):
        if f"{prefix}_offset" in params:
            sideways, turned = (params.get(f"{prefix}_{key}_offset", 0.0) for key in ("side", "angular"))
            more = {field: params[name] for field, name in OWN_PARAMETERS.items() if name in params}
            return {"x": params[f"{prefix}_offset"], "y": sideways, "yaw": turned, **more}
    if not len(rows):
        return {}
    mounts = se2.between(rows[:, 3:6], rows[:, :3])
    middle = np.median(mounts, axis=0)
    apart = np.abs(np.column_stack((mounts[:, :2] - middle[:2], se2.wrap(mounts[:, 2] - middle[2]))))
    if np.quantile(apart.max(axis=1), 0.99) >= _SAME:
        return {}
    x, y, yaw = np.round(middle, 6).tolist()  # logs have six digits
    return {"x": x, "y": y, "yaw": yaw}


FORMAT = Format(
    "CARMEN log (FLASER, ROBOTLASER1, RAWLASER1, ODOM lines; plain or gzip)",
    is_folder=False,
    recognise=is_carmen,
    read=read_carmen,
    write=write_carmen,
    endings=(".log", ".log.gz", ".clf", ".clf.gz"),
)
