"""CARMEN logs are written: ROBOTLASER1, ODOM and PARAM lines. What comes back: ``docs/reference/formats.md``."""

from __future__ import annotations

import gzip
import math
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.streams import no_return_codes
from moteslam.robot.formats.written import computed_odometry, not_written
from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LidarStream, Recording, phases
from moteslam.robot.values import Issue, counted, expect_type

CLASSIC_STEPS = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Degrees between the beams of the lasers that classic logs are of, by the number of beams."""
OWN_PARAMETERS = {"z": "robot_frontlaser_height", "time_increment": "robot_frontlaser_time_increment"}
"""Parameters of our own for what CARMEN has none: the lidar's height [m], and the time between its beams [s]."""
_SAME_ANGLE = 1e-4


def fov_of(beams: int) -> tuple[float, float]:
    """First angle and step [rad] of a FLASER line, which states neither: by the number of beams.

    180 and 181 beams are one degree apart, 360 and 361 half a degree; any other number spans 180 degrees. The first
    looks to -90 degrees.
    """
    return -math.pi / 2, math.radians(CLASSIC_STEPS.get(beams, 180 / max(beams - 1, 1)))


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
    lidar, odometry, mount = recording.lidar, recording.odometry, recording.platform.lidar
    params = {"robot_length": recording.platform.length, "robot_width": recording.platform.width}
    params |= {f"robot_frontlaser_{key}": getattr(mount, of) for key, of in _OFFSETS.items()}
    if mount.z:
        params[OWN_PARAMETERS["z"]] = mount.z
    if lidar is not None and lidar.time_increment:
        params[OWN_PARAMETERS["time_increment"]] = lidar.time_increment * lidar.interlace
    entries: list[tuple[float, int, str]] = []
    if odometry is not None:
        for stamp, (x, y, theta) in zip(odometry.stamps.tolist(), odometry.poses.tolist(), strict=True):
            entries.append((stamp, 0, f"ODOM {x!r} {y!r} {theta!r} 0 0 0 {_clock(stamp)}"))
    if lidar is not None:
        params["robot_front_laser_max"] = lidar.range_max
        if lidar.odometry is not None:
            entries += _scan_entries(lidar, lidar.odometry, mount)
        elif odometry is not None:
            poses = se2.interpolate(odometry.stamps, odometry.poses, lidar.stamps)
            entries += _scan_entries(lidar, poses, mount)
    if not entries or (lidar is not None and odometry is None and lidar.odometry is None):
        raise InputError("no odometry poses, expected them for a CARMEN log", field="odometry")
    entries.sort(key=lambda entry: entry[:2])  # stable: equal stamps stay in order
    head = ["# CARMEN log written by moteslam", *(f"PARAM {name} {value!r}" for name, value in params.items())]
    data = ("\n".join([*head, *(line for _, _, line in entries)]) + "\n").encode()
    write_atomically(path, gzip.compress(data, mtime=0) if Path(path).suffix == ".gz" else data)


_OFFSETS = {"offset": "x", "side_offset": "y", "angular_offset": "yaw"}


def expect_classic_fan(beams: int, angle_min: float, angle_increment: float) -> None:
    """Refuse a lidar that no FLASER line can hold: these state a number of beams, and neither angles nor steps [rad].

    ``write_carmen`` itself writes any fan: its ROBOTLASER1 lines state the angles.
    """
    first, step = fov_of(beams)
    off = max(abs(angle_min - first), abs(angle_min + (beams - 1) * angle_increment - first - (beams - 1) * step))
    if beams not in CLASSIC_STEPS or off > _SAME_ANGLE:
        span, start = (beams - 1) * math.degrees(angle_increment), math.degrees(angle_min)
        problem = f"{counted(beams, 'beam')} over {span:.4g} degrees from {start:.4g}, expected for a CARMEN log 180 "
        problem += "or 181 beams a degree apart, or 360 or 361 half a degree, from -90"
        raise ConfigError(problem, field="format")


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


def _scan_entries(lidar: LidarStream, poses: se2.Poses, mount: LidarSpec) -> list[tuple[float, int, str]]:
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
        numbers = " ".join(scan[begin::every].astype(str).tolist())  # the fewest digits that give the same float32
        places = " ".join(map(repr, [*laser.tolist(), *pose.tolist()]))
        entries.append((stamp, 1, f"{kinds[begin]} {numbers} 0 {places} 0 0 0 0 0 {_clock(stamp)}"))
    return entries


def _clock(stamp: float) -> str:
    return f"{stamp!r} moteslam {stamp!r}"
