"""CARMEN logs are written: ROBOTLASER1, ODOM and PARAM lines. What comes back: ``docs/reference/formats.md``."""

from __future__ import annotations

import gzip
import math
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.carmen_lines import CLASSIC_STEPS, fov_of
from moteslam.robot.formats.no_return import no_return_codes
from moteslam.robot.formats.not_written import not_written
from moteslam.robot.formats.written_odometry import computed_odometry
from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LidarStream, Recording, phases
from moteslam.robot.values import Issue, counted, expect_type

OWN_PARAMETERS = {"z": "robot_frontlaser_height", "time_increment": "robot_frontlaser_time_increment"}
"""Parameters of our own for what CARMEN has none: the lidar's height [m], and the time between its beams [s]."""
_SAME_ANGLE = 1e-4


def write_carmen(path: str | PathLike[str], recording: Recording) -> None:
    """Write the lidar and odometry of a recording as a CARMEN log (ROBOTLASER1, ODOM and PARAM lines).

    No return is written as the sensor's limit, stated as ``robot_front_laser_max``, and an invalid reading as
    0, so that stamps, ranges and poses read back the same, bit for bit. The lidar's height and ``time_increment`` are
    parameters of our own, which other programs pass over. The same recording gives the same bytes.

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
    if mount.z:
        head.append(f"PARAM {OWN_PARAMETERS['z']} {mount.z!r}")
    if lidar is not None and lidar.time_increment:
        head.append(f"PARAM {OWN_PARAMETERS['time_increment']} {lidar.time_increment * lidar.interlace!r}")
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


def write_log(path: Path, recording: Recording) -> tuple[Issue, ...]:
    """`write_carmen`, and what the log does not hold of the recording, an issue each.

    A recording without odometry poses gets those of its wheels: a log without is of no use.
    """
    lidar, logged = recording.lidar, recording
    issues: tuple[Issue, ...] = ()
    has_poses = recording.odometry is not None or (lidar is not None and lidar.odometry is not None)
    if not has_poses and (computed := computed_odometry(recording)) is not None:
        logged = recording.replace(odometry=computed)
        text = f"{recording.name}: {counted(len(computed), 'odometry pose')} computed of the wheels and written"
        issues = (Issue("computed-odometry", text, len(computed)),)
    write_carmen(path, logged)
    return (*issues, *not_written(recording, "a CARMEN log", ("encoders", "imu", "rgbd")))


def _scan_entries(lidar: LidarStream, poses: NDArray[np.float64], mount: LidarSpec) -> list[tuple[float, int, str]]:
    ranges, every = np.asarray(lidar.ranges), lidar.interlace
    beams = ranges.shape[1]
    codes = no_return_codes(mount.no_return, lidar.range_max, lidar.range_max, beams)
    coded = np.where(np.isinf(ranges), codes, ranges)
    coded[np.isnan(coded)] = 0
    step = lidar.angle_increment * every
    kinds = []
    for begin in range(every):
        first, count = lidar.angle_min + begin * lidar.angle_increment, len(range(begin, beams, every))
        fan = f"{first!r} {step * (count - 1)!r} {step!r}"
        kinds.append(f"ROBOTLASER1 0 {fan} {lidar.range_max!r} 0.01 0 {count}")
    entries = []
    lasers = se2.compose(poses, mount.pose)
    begins = phases(ranges, every).tolist()
    for stamp, scan, begin, laser, pose in zip(lidar.stamps.tolist(), coded, begins, lasers, poses, strict=True):
        kind, ranges = kinds[begin], scan[begin::every]
        numbers = " ".join(ranges.astype(str).tolist())  # the fewest digits that give the same float32
        places = " ".join(map(repr, [*laser.tolist(), *pose.tolist()]))
        entries.append((stamp, 1, f"{kind} {numbers} 0 {places} 0 0 0 0 0 {_clock(stamp)}"))
    return entries


def _clock(stamp: float) -> str:
    return f"{stamp!r} moteslam {stamp!r}"
