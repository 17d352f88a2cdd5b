"""Recordings written as CARMEN logs and as CSV files, and what a format cannot hold of them.

The same recording gives the same bytes. What comes back: ``docs/reference/formats.md``.
"""

import gzip
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from moteslam.errors import InputError, OutputError
from moteslam.files import write_atomically
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import platform_table
from moteslam.robot.recording import LidarStream, OdometryStream, Ranges, Recording, Stream, chunks, phases
from moteslam.robot.values import Issue, counted, expect_type
from moteslam.robot.wheel_odometry import wheel_path

SCAN_POSES = "scan poses"
_WORDS = {"encoders": "encoder reading", "imu": "IMU reading", "rgbd": "image"}


def not_written(recording: Recording, where: str, *names: str) -> tuple[Issue, ...]:
    """An issue for each of some streams, or the poses logged with scans, that a recording has and that is left out."""
    issues = []
    for name in names:
        stream: Any = recording.lidar if name == SCAN_POSES else getattr(recording, name)
        if stream is None or (name == SCAN_POSES and stream.odometry is None):
            continue
        count = len(stream.rgb_stamps) + len(stream.disparity_stamps) if name == "rgbd" else len(stream)
        if count:
            what = counted(count, _WORDS.get(name, "odometry pose")) + (" of scans" if name == SCAN_POSES else "")
            issues.append(Issue("not-written", f"{recording.name}: {what} not written, no place in {where}", count))
    return tuple(issues)


def coded_ranges(lidar: LidarStream, robot: Platform, *, no_return: float, invalid: float) -> NDArray[np.float32]:
    """Ranges [n, beams] [m] as sensors report them; for no return the robot's codes in turns, if they read as that."""
    codes = [code for code in robot.lidar.no_return if lidar.range_max <= code < np.inf] or [no_return]
    ranges = np.asarray(lidar.ranges)
    coded = np.where(np.isinf(ranges), np.resize(np.asarray(codes, np.float32), ranges.shape[1]), ranges)
    coded[np.isnan(coded)] = invalid
    return coded


WrittenOdometry = tuple[OdometryStream | None, bool, tuple[Issue, ...]]
"""The odometry that a bag or a log gets, and whether it is computed: the recording has not these poses."""


def odometry_of(recording: Recording) -> WrittenOdometry:
    """The recording's odometry, else that of its wheels (`wheel_path`), else the poses logged with the scans."""
    if recording.odometry is not None and len(recording.odometry):
        return recording.odometry, False, ()
    encoders, lidar = recording.encoders, recording.lidar
    if encoders is not None and len(encoders) and recording.platform.wheels is not None:
        return OdometryStream(encoders.stamps, wheel_path(recording)), True, ()
    if lidar is not None and lidar.odometry is not None and len(lidar):
        issue = Issue("scan-poses", f"{recording.name}: the poses of the scans are written as odometry", len(lidar))
        return OdometryStream(lidar.stamps, lidar.odometry), False, (issue,)
    issue = Issue("no-odometry", f"{recording.name}: neither odometry nor wheels: no /odom is written")
    return None, True, (issue,)


CLASSIC_STEPS = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Degrees between the beams of the lasers that classic CARMEN logs are of, by the number of beams."""
OWN_PARAMETERS = {"z": "robot_frontlaser_height", "time_increment": "robot_frontlaser_time_increment"}
"""Parameters of our own, which CARMEN lacks: the lidar's height [m], and the time between its beams [s],
below 0 where the last beam is measured first."""
_OFFSETS = {"offset": "x", "side_offset": "y", "angular_offset": "yaw"}


def fov_of(beams: int) -> tuple[float, float]:
    """First angle, -90 degrees, and step [rad] of a FLASER line, which states neither; 180 degrees if not classic."""
    return -math.pi / 2, math.radians(CLASSIC_STEPS.get(beams, 180 / max(beams - 1, 1)))


def write_carmen(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write the lidar and odometry of a recording as a CARMEN log (ROBOTLASER1, ODOM and PARAM lines).

    No return is written as the sensor's limit, stated as ``robot_front_laser_max``, and an invalid reading as
    0, so that stamps, ranges and poses read back the same, bit for bit. A recording without poses gets those of its
    wheels. A name that ends in ``.gz`` is packed. What the log does not hold of the recording is returned.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    lidar, odometry, mount = recording.lidar, recording.odometry, recording.platform.lidar
    issues: tuple[Issue, ...] = ()
    if lidar is not None and lidar.angle_increment < 0:  # CARMEN's scans go counterclockwise: the last beam first
        first, step, time = lidar.angles[-1], -lidar.angle_increment, -lidar.time_increment
        ranges = np.asarray(lidar.ranges)[:, ::-1]
        lidar = replace(lidar, ranges=ranges, angle_min=first, angle_increment=step, time_increment=time)
    if odometry is None and (lidar is None or lidar.odometry is None):
        if (odometry := odometry_of(recording)[0]) is None:
            raise InputError("no odometry poses, expected them for a CARMEN log", field="odometry")
        text = f"{recording.name}: {counted(len(odometry), 'odometry pose')} computed of the wheels and written"
        issues = (Issue("computed-odometry", text, len(odometry)),)
    params = {"robot_length": recording.platform.length, "robot_width": recording.platform.width}
    params |= {f"robot_frontlaser_{key}": getattr(mount, of) for key, of in _OFFSETS.items()}
    if mount.z:
        params[OWN_PARAMETERS["z"]] = mount.z
    entries: list[tuple[float, int, str]] = []
    if odometry is not None:
        for stamp, pose in zip(odometry.stamps.tolist(), odometry.poses.tolist(), strict=True):
            entries.append((stamp, 0, f"ODOM {' '.join(map(repr, pose))} 0 0 0 {_clock(stamp)}"))
    if lidar is not None:
        if lidar.time_increment:
            params[OWN_PARAMETERS["time_increment"]] = lidar.time_increment * lidar.interlace
        params["robot_front_laser_max"] = lidar.range_max
        poses = lidar.odometry
        if poses is None and odometry is not None:
            poses = se2.interpolate(odometry.stamps, odometry.poses, lidar.stamps)
        assert poses is not None
        entries += _scan_entries(lidar, poses, recording.platform)
    entries.sort(key=lambda entry: entry[:2])  # stable: equal stamps stay in order
    head = ["# CARMEN log written by moteslam", *(f"PARAM {name} {value!r}" for name, value in params.items())]
    data = ("\n".join([*head, *(line for _, _, line in entries)]) + "\n").encode()
    write_atomically(path, gzip.compress(data, mtime=0) if Path(path).suffix == ".gz" else data)
    return (*issues, *not_written(recording, "a CARMEN log", "encoders", "imu", "rgbd"))


def _scan_entries(lidar: LidarStream, poses: se2.Poses, platform: Platform) -> list[tuple[float, int, str]]:
    coded, every = coded_ranges(lidar, platform, no_return=lidar.range_max, invalid=0.0), lidar.interlace
    kinds, step = list[str](), lidar.angle_increment * every
    for begin in range(every):
        first, count = lidar.angle_min + begin * lidar.angle_increment, len(range(begin, coded.shape[1], every))
        fan = f"{first!r} {step * (count - 1)!r} {step!r}"
        kinds.append(f"ROBOTLASER1 0 {fan} {lidar.range_max!r} 0.01 0 {count}")
    entries = []
    lasers = se2.compose(poses, platform.lidar.pose)
    begins = phases(np.asarray(lidar.ranges), every).tolist()
    for stamp, scan, begin, laser, pose in zip(lidar.stamps.tolist(), coded, begins, lasers, poses, strict=True):
        numbers = " ".join(scan[begin::every].astype(str).tolist())  # the fewest digits that give the same float32
        places = " ".join(map(repr, [*laser.tolist(), *pose.tolist()]))
        entries.append((stamp, 1, f"{kinds[begin]} {numbers} 0 {places} 0 0 0 0 0 {_clock(stamp)}"))
    return entries


def _clock(stamp: float) -> str:
    return f"{stamp!r} moteslam {stamp!r}"


POSE = ("x", "y", "theta")
FOUR_WHEELS = ("front_right", "front_left", "rear_right", "rear_left")
"""The keys of the wheels, in the order of a recording's counts."""
RATES = ("roll_rate", "pitch_rate", "yaw_rate")
ACCELERATION = ("acceleration_x", "acceleration_y", "acceleration_z")


def write_csv(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a TOML and, beside it, a CSV file a stream: ``walk.toml``, ``walk-lidar.csv`` and so on.

    No return is ``inf``, an invalid range an empty cell. ``read_csv_log`` gives the same streams and robot back, bit
    for bit, as long as the finite ranges are above 0 and lie within ``range_min <= r < range_max``. Images are left
    out, which is an issue.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    path = Path(path)
    if path.suffix != ".toml":
        raise OutputError("expected a name that ends in .toml", file=path)
    tables: dict[str, Any] = {"name": recording.name}

    def write(name: str, stream: Stream, names: Sequence[str], values: NDArray[Any], table: dict[str, Any]) -> None:
        file = path.with_name(f"{path.stem}-{name}.csv")
        tables[name] = {"file": file.name, "stamp": "stamp", **table}
        ranges = stream.ranges if isinstance(stream, LidarStream) else np.empty((len(stream), 0), np.float32)

        def content(out: IO[bytes]) -> None:
            out.write((",".join(["stamp", *names, *(f"r{beam}" for beam in range(ranges.shape[1]))]) + "\n").encode())
            for stamp, row, more in zip(stream.stamps.tolist(), values.tolist(), _cells(ranges), strict=True):
                out.write((",".join([repr(stamp), *map(repr, row), *more]) + "\n").encode())

        write_atomically(file, content)

    if lidar := recording.lidar:
        figures = {key: getattr(lidar, key) for key in ("angle_min", "angle_increment", "range_min", "range_max")}
        table = {"ranges": f"r0..r{lidar.ranges.shape[1] - 1}", **figures}
        names, poses = ((), np.empty((len(lidar), 0))) if lidar.odometry is None else (POSE, lidar.odometry)
        write("lidar", lidar, names, poses, table | ({"odometry": list(POSE)} if names else {}))
    if odometry := recording.odometry:
        write("odometry", odometry, POSE, odometry.poses, dict(zip(POSE, POSE, strict=True)))
    if encoders := recording.encoders:
        table = {**{key: key for key in FOUR_WHEELS}, "running": False}
        write("encoders", encoders, FOUR_WHEELS, encoders.counts, table)
    if imu := recording.imu:
        values = np.concatenate((imu.angular_velocity, imu.linear_acceleration_g), axis=1)
        table = {**{key: key for key in RATES}, "acceleration": list(ACCELERATION)}
        write("imu", imu, (*RATES, *ACCELERATION), values, table)
    if len(tables) == 1:
        raise InputError("no stream with readings, expected a lidar, odometry, encoders or an IMU", file=recording.name)
    tables["platform"] = platform_table(recording.platform)
    write_atomically(path, tomli_w.dumps(tables))  # last: it describes complete files
    return not_written(recording, "a CSV log", "rgbd")


def _cells(ranges: Ranges) -> Iterator[list[str]]:
    """The cells of each scan, with the fewest digits that give the same float32."""
    for some in chunks(ranges):
        cells = some.astype(str)
        cells[np.isnan(some)] = ""
        yield from cells.tolist()
