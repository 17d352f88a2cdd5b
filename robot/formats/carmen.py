"""CARMEN logs, plain or gzip: read and written. Lines, rules and bounds: ``docs/reference/formats.md``."""

from __future__ import annotations

import gzip
import math
import re
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.carmen_lines import (
    CLASSIC_STEPS,
    RAW_LASERS,
    SHORT_TAILS,
    CarmenLines,
    ScanKind,
    Scans,
    fov_of,
    parse_lines,
)
from moteslam.robot.formats.format import Format, Robot
from moteslam.robot.formats.no_return import no_return_codes, no_return_limit
from moteslam.robot.formats.not_written import left_out, not_written
from moteslam.robot.formats.streams import Fan, lidar_stream, mount_between, odometry_stream
from moteslam.robot.formats.text import TextLines
from moteslam.robot.formats.words import MAX_BROKEN, broken_issues
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import CARMEN
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.specs import LidarSpec
from moteslam.robot.wording import counted, expect_type, first_complaint

_LINE = re.compile(rb"^(?:FLASER|ROBOTLASER1|RAWLASER[1-5]|ODOM|PARAM)\s", re.MULTILINE)
_LIMITS = ("robot_front_laser_max", "robot_frontlaser_max", "laser_front_max_range", "front_laser_max")
_SAME_ANGLE = 1e-4


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
    path = Path(path)
    lines = TextLines(path)
    log = parse_lines(lines)
    issues = broken_issues(lines, log.broken, log.used, "no FLASER, ROBOTLASER1 or ODOM line, expected a CARMEN log")
    chosen = _choose(path, log, issues)
    odometry = np.array(log.odometry, np.float64).reshape(-1, 5)
    rows = np.array(chosen[1].rows if chosen else (), np.float64).reshape(-1, 8)
    if chosen and chosen[0].line == "FLASER" and log.flaser_tail == min(SHORT_TAILS):
        rows[:, 6] = np.arange(len(rows))
        odometry = _without_stamps(path, odometry, issues)
    clock = -2 if (rows[:, 6] != 0).any() or (odometry[:, 3] != 0).any() else -1
    given = GivenRobot.read(platform)
    has_poses = chosen is not None and chosen[0].line not in RAW_LASERS
    robot = given.over(_platform(path, log, rows if has_poses else rows[:0]))
    return Recording(
        name=re.sub(r"(\.log|\.clf)?(\.gz)?$", "", path.name) or path.name,
        platform=robot,
        lidar=chosen
        and _lidar(
            path, log, chosen, rows=rows, clock=clock, robot=robot, given=given, has_poses=has_poses, issues=issues
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


def _choose(path: Path, log: CarmenLines, issues: list[Issue]) -> tuple[ScanKind, Scans] | None:
    """The kind of scan most frequent in the log (of equals, the one that states its angles); others are left aside.

    Scans of a laser that looks back are left aside whatever their number.

    Raises:
        InputError: a tenth of the scans of that kind of line have other beams: the log is two.
    """
    for line, (count, first) in log.rear.items():
        text = f"{path.name}: {counted(count, f'{line} scan')} of a rear laser left aside, the first is line {first}"
        issues.append(Issue("other-scans", text, count))
    if not log.scans:
        return None
    kind, scans = max(log.scans.items(), key=lambda item: (len(item[1]), item[0].line == "ROBOTLASER1"))
    for other, left in log.scans.items():
        if other == kind:
            continue
        text = f"{counted(len(left), f'{other.line} scan')} of {counted(other.beams, 'beam')}"
        if other.line == kind.line and len(left) > max(MAX_BROKEN, len(scans) // 10):
            raise InputError(
                f"{text}, expected {kind.beams} beams from {kind.angle_min:.4f} rad as in the other {len(scans)}",
                file=path,
                line=left.first_line,
            )
        text = f"{path.name}: {text} left aside, the first is line {left.first_line}"
        issues.append(Issue("other-scans", text, len(left)))
    return kind, scans


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
            return LidarSpec(x=params[f"{prefix}_offset"], y=sideways, yaw=turned)
    return mount_between(rows[:, 3:6], rows[:, :3]) or LidarSpec()


def _lidar(
    path: Path,
    log: CarmenLines,
    chosen: tuple[ScanKind, Scans],
    *,
    rows: NDArray[np.float64],
    clock: int,
    robot: Platform,
    given: GivenRobot,
    has_poses: bool,
    issues: list[Issue],
) -> LidarStream:
    """The scans; figures that a caller's ``platform.toml`` gives are taken in place of the log's."""
    kind, scans = chosen
    ranges = np.array(scans.ranges, np.float32).reshape(-1, kind.beams)
    stated = next((log.params[key] for key in _LIMITS if log.params.get(key, 0) > 0), scans.stated)
    figures = given.lidar_figures
    range_max = figures.get("range_max") or no_return_limit(ranges, stated)
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
    )


def write_carmen(path: str | PathLike[str], recording: Recording) -> None:
    """Write the lidar and odometry of a recording as a CARMEN log (ROBOTLASER1, ODOM and PARAM lines).

    No return is written as the sensor's limit, stated as ``robot_front_laser_max``, and an invalid reading as
    0, so that stamps, ranges and poses read back the same, bit for bit. Heights and the lidar's ``time_increment``
    cannot be written to a log. The same recording gives the same bytes.

    Args:
        path: the file; gzip where it ends in ``.gz``.
        recording: it needs ``odometry``, or a lidar with poses.

    Raises:
        InputError: no odometry poses.
        OutputError: the file cannot be written.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    lidar, odometry, robot = recording.lidar, recording.odometry, recording.platform
    mount = robot.lidar
    entries: list[tuple[float, int, str]] = []
    head = [
        "# CARMEN log written by moteslam",
        f"PARAM robot_length {robot.length!r}",
        f"PARAM robot_width {robot.width!r}",
        f"PARAM robot_frontlaser_offset {mount.x!r}",
        f"PARAM robot_frontlaser_side_offset {mount.y!r}",
        f"PARAM robot_frontlaser_angular_offset {mount.yaw!r}",
    ]
    if odometry is not None:
        for stamp, (x, y, theta) in zip(odometry.stamps.tolist(), odometry.poses.tolist(), strict=True):
            entries.append((stamp, 0, f"ODOM {x!r} {y!r} {theta!r} 0 0 0 {_clock(stamp)}"))
    if lidar is not None:
        if lidar.odometry is not None:
            poses = lidar.odometry
        elif odometry is not None:
            poses = se2.interpolate(odometry.stamps, odometry.poses, lidar.stamps)
        else:
            raise InputError("no odometry poses, expected them for a CARMEN log", field="odometry")
        head.append(f"PARAM robot_front_laser_max {lidar.range_max!r}")
        entries += _scan_entries(lidar, poses, mount)
    if not entries:
        raise InputError("neither a lidar nor odometry, expected one for a CARMEN log", field="odometry")
    entries.sort(key=lambda entry: entry[:2])  # stable: equal stamps stay in order
    text = "\n".join([*head, *(line for _, _, line in entries)]) + "\n"
    data = text.encode()
    write_atomically(path, gzip.compress(data, mtime=0) if Path(path).suffix == ".gz" else data)


def expect_classic_fan(beams: int, angle_min: float, angle_increment: float) -> None:
    """Refuse a lidar that no FLASER line can hold: these state a number of beams, and neither angles nor steps.

    Readers take 180 and 181 beams for a degree apart, 360 and 361 for half a degree, the first at -90 degrees.
    ``write_carmen`` itself writes any fan: its ROBOTLASER1 lines state the angles.

    Args:
        beams: of a scan.
        angle_min: of the first beam, in the lidar's frame [rad].
        angle_increment: between beams [rad].

    Raises:
        ConfigError: other beams; its field is ``format``.
    """
    first, step = fov_of(beams)
    off = max(abs(angle_min - first), abs(angle_min + (beams - 1) * angle_increment - first - (beams - 1) * step))
    if beams not in CLASSIC_STEPS or off > _SAME_ANGLE:
        span, start = (beams - 1) * math.degrees(angle_increment), math.degrees(angle_min)
        raise ConfigError(
            f"{counted(beams, 'beam')} over {span:.4g} degrees from {start:.4g}, expected for a CARMEN log 180 or "
            "181 beams a degree apart, or 360 or 361 half a degree, from -90",
            field="format",
        )


def _scan_entries(lidar: LidarStream, poses: NDArray[np.float64], mount: LidarSpec) -> list[tuple[float, int, str]]:
    ranges = np.asarray(lidar.ranges)
    beams = ranges.shape[1]
    codes = no_return_codes(mount.no_return, lidar.range_max, lidar.range_max, beams)
    coded = np.where(np.isinf(ranges), codes, ranges)
    coded[np.isnan(coded)] = 0
    kind = (
        f"ROBOTLASER1 0 {lidar.angle_min!r} {lidar.angle_increment * (beams - 1)!r} "
        f"{lidar.angle_increment!r} {lidar.range_max!r} 0.01 0 {beams}"
    )
    entries = []
    lasers = se2.compose(poses, mount.pose)
    for stamp, ranges, laser, pose in zip(lidar.stamps.tolist(), coded, lasers, poses, strict=True):
        numbers = " ".join(ranges.astype(str).tolist())  # the fewest digits that give the same float32
        places = " ".join(map(repr, [*laser.tolist(), *pose.tolist()]))
        entries.append((stamp, 1, f"{kind} {numbers} 0 {places} 0 0 0 0 0 {_clock(stamp)}"))
    return entries


def _clock(stamp: float) -> str:
    return f"{stamp!r} moteslam {stamp!r}"


def _read(path: Path, sequence: str | int | None, platform: Robot) -> Recording:
    if sequence is not None:
        raise InputError("a CARMEN log is one sequence, expected none to be named", file=path, field="sequence")
    return read_carmen(path, platform=platform)


def _write(path: Path, recording: Recording) -> tuple[Issue, ...]:
    write_carmen(path, recording)
    issues = list(not_written(recording, "a CARMEN log", ("encoders", "imu", "rgbd")))
    lidar, mount = recording.lidar, recording.platform.lidar
    if mount.z:
        issues.append(left_out(recording, "a CARMEN log", "the lidar's height"))
    if lidar is not None and lidar.time_increment:
        issues.append(left_out(recording, "a CARMEN log", "the time between beams"))
    return tuple(issues)


FORMAT = Format(
    "CARMEN log (FLASER, ROBOTLASER1, RAWLASER1, ODOM lines; plain or gzip)",
    is_folder=False,
    recognise=is_carmen,
    read=_read,
    write=_write,
    endings=(".log", ".log.gz", ".clf", ".clf.gz"),
)
