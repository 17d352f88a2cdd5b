"""Recordings written as CARMEN logs and as CSV files, and what a format cannot hold of them.

The same recording gives the same bytes. What comes back: ``docs/reference/formats.md``.
"""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import platform_table
from moteslam.robot.recording import LidarStream, OdometryStream, Recording, chunks, phases
from moteslam.robot.values import Issue, counted, expect_type
from moteslam.robot.wheel_odometry import wheel_path

_WORDS = {"encoders": "encoder reading", "odometry": "odometry pose", "imu": "IMU reading", "rgbd": "image"}
SCAN_POSES = "scan poses"


def not_written(recording: Recording, where: str, *names: str) -> tuple[Issue, ...]:
    """An issue for each of some streams, or the poses logged with scans, that a recording has and that is left out."""
    issues = []
    for name in names:
        count, word = 0, _WORDS.get(name, "odometry pose")
        if name == SCAN_POSES:
            lidar = recording.lidar
            count = 0 if lidar is None or lidar.odometry is None else len(lidar)
        elif name == "rgbd":
            count = sum(len(stamps) for kind, stamps in recording.stamps().items() if kind in ("rgb", "disparity"))
        elif (stream := getattr(recording, name)) is not None:
            count = len(stream)
        if count:
            what = counted(count, word) + (" of scans" if name == SCAN_POSES else "")
            text = f"{recording.name}: {what} not written, no place in {where}"
            issues.append(Issue("not-written", text, count))
    return tuple(issues)


def no_return_codes(codes: tuple[float, ...], range_max: float, otherwise: float, beams: int) -> NDArray[np.float32]:
    """What is written for no return, a value a beam [beams] [m]: those of the lidar's codes that read as no return."""
    usable = [code for code in codes if code >= range_max] or [otherwise]
    return np.resize(np.asarray(usable, np.float32), beams)


@dataclass(frozen=True, eq=False)
class WrittenOdometry:
    """The odometry that a bag or a log gets; ``is_computed`` where the recording has not these poses."""

    stream: OdometryStream | None
    is_computed: bool = False
    issues: tuple[Issue, ...] = ()


def odometry_of(recording: Recording) -> WrittenOdometry:
    """The recording's odometry, else that of its wheels (`wheel_path`), else the poses logged with the scans."""
    if recording.odometry is not None and len(recording.odometry):
        return WrittenOdometry(recording.odometry)
    encoders, lidar = recording.encoders, recording.lidar
    if encoders is not None and len(encoders) and recording.platform.wheels is not None:
        return WrittenOdometry(OdometryStream(encoders.stamps, wheel_path(recording)), is_computed=True)
    if lidar is not None and lidar.odometry is not None and len(lidar):
        issue = Issue("scan-poses", f"{recording.name}: the poses of the scans are written as odometry", len(lidar))
        return WrittenOdometry(OdometryStream(lidar.stamps, lidar.odometry), issues=(issue,))
    issue = Issue("no-odometry", f"{recording.name}: neither odometry nor wheels: no /odom is written")
    return WrittenOdometry(None, is_computed=True, issues=(issue,))


CLASSIC_STEPS = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Degrees between the beams of the lasers that classic CARMEN logs are of, by the number of beams."""
OWN_PARAMETERS = {"z": "robot_frontlaser_height", "time_increment": "robot_frontlaser_time_increment"}
"""Parameters of our own for what CARMEN has none: the lidar's height [m], and the time between its beams [s]."""
_OFFSETS = {"offset": "x", "side_offset": "y", "angular_offset": "yaw"}
_SAME_ANGLE = 1e-4


def fov_of(beams: int) -> tuple[float, float]:
    """First angle and step [rad] of a FLASER line, which states neither: by the number of beams.

    180 and 181 beams are one degree apart, 360 and 361 half a degree; any other number spans 180 degrees. The first
    looks to -90 degrees.
    """
    return -math.pi / 2, math.radians(CLASSIC_STEPS.get(beams, 180 / max(beams - 1, 1)))


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


def write_carmen(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write the lidar and odometry of a recording as a CARMEN log (ROBOTLASER1, ODOM and PARAM lines).

    No return is written as the sensor's limit, stated as ``robot_front_laser_max``, and an invalid reading as
    0, so that stamps, ranges and poses read back the same, bit for bit. The lidar's height and ``time_increment`` are
    parameters of our own, which other programs pass over. A recording without poses gets those of its wheels.

    Args:
        path: the file; gzip where it ends in ``.gz``.
        recording: it needs odometry, a lidar with poses, or wheels.

    Returns:
        what the log does not hold of the recording, an issue each.

    Raises:
        InputError: no odometry poses.
        OutputError: the file cannot be written.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    lidar, odometry, mount = recording.lidar, recording.odometry, recording.platform.lidar
    issues: tuple[Issue, ...] = ()
    if odometry is None and (lidar is None or lidar.odometry is None):
        written = odometry_of(recording)
        if (odometry := written.stream) is None:
            raise InputError("no odometry poses, expected them for a CARMEN log", field="odometry")
        text = f"{recording.name}: {counted(len(odometry), 'odometry pose')} computed of the wheels and written"
        issues = (Issue("computed-odometry", text, len(odometry)),)
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
    ranges, every, mount = np.asarray(lidar.ranges), lidar.interlace, platform.lidar
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


POSE = ("x", "y", "theta")
FOUR_WHEELS = ("front_right", "front_left", "rear_right", "rear_left")
"""The keys of the wheels, in the order of a recording's counts."""
RATES = ("roll_rate", "pitch_rate", "yaw_rate")
ACCELERATION = ("acceleration_x", "acceleration_y", "acceleration_z")

Rows = Iterator[Sequence[object]]


def write_csv(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a TOML and, beside it, a CSV file a stream: ``walk.toml``, ``walk-lidar.csv`` and so on.

    Numbers have the fewest digits that read back the same; no return is ``inf``, a reading that says nothing an empty
    cell. So ``read_csv_log`` gives the same streams and robot back, bit for bit, as long as the finite ranges are
    above 0 and lie within ``range_min <= r < range_max``. The TOML is written last: it describes complete files.

    Args:
        path: of the TOML; its folder must exist.
        recording: what to write.

    Returns:
        an issue for what CSV files cannot hold: images.

    Raises:
        InputError: no stream with readings.
        OutputError: a name that does not end in ``.toml``; or a file cannot be written.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    path = Path(path)
    if path.suffix != ".toml":
        raise OutputError("expected a name that ends in .toml", file=path)
    streams: dict[str, tuple[dict[str, Any], Rows]] = {}
    if recording.lidar:
        streams["lidar"] = _lidar_table(recording.lidar), _lidar_rows(recording.lidar)
    if odometry := recording.odometry:
        streams["odometry"] = {key: key for key in POSE}, _rows(POSE, odometry.stamps, odometry.poses)
    if encoders := recording.encoders:
        table = {**{key: key for key in FOUR_WHEELS}, "running": False}
        streams["encoders"] = table, _rows(FOUR_WHEELS, encoders.stamps, encoders.counts)
    if imu := recording.imu:
        values = np.concatenate((imu.angular_velocity, imu.linear_acceleration_g), axis=1)
        table = {**{key: key for key in RATES}, "acceleration": list(ACCELERATION)}
        streams["imu"] = table, _rows((*RATES, *ACCELERATION), imu.stamps, values)
    if not streams:
        raise InputError("no stream with readings, expected a lidar, odometry, encoders or an IMU", file=recording.name)
    tables: dict[str, Any] = {"name": recording.name}
    for name, (table, rows) in streams.items():
        file = path.with_name(f"{path.stem}-{name}.csv")
        _write_rows(file, rows)
        tables[name] = {"file": file.name, "stamp": "stamp", **table}
    tables["platform"] = platform_table(recording.platform)
    write_atomically(path, tomli_w.dumps(tables))
    return not_written(recording, "a CSV log", "rgbd")


def _write_rows(file: Path, rows: Rows) -> None:
    def content(out: IO[bytes]) -> None:
        for row in rows:
            out.write((",".join(map(str, row)) + "\n").encode())

    write_atomically(file, content)


def _lidar_table(lidar: LidarStream) -> dict[str, Any]:
    figures = {name: getattr(lidar, name) for name in ("angle_min", "angle_increment", "range_min", "range_max")}
    poses = {} if lidar.odometry is None else {"odometry": list(POSE)}
    return {"ranges": f"r0..r{lidar.ranges.shape[1] - 1}", **figures, **poses}


def _lidar_rows(lidar: LidarStream) -> Rows:
    poses: NDArray[np.float64] = np.empty((len(lidar), 0)) if lidar.odometry is None else lidar.odometry
    yield ["stamp", *(() if lidar.odometry is None else POSE), *(f"r{beam}" for beam in range(lidar.ranges.shape[1]))]
    heads = zip(lidar.stamps.tolist(), poses.tolist(), strict=True)
    for some in chunks(lidar.ranges):
        cells = some.astype(str)  # the fewest digits that give the same float32
        cells[np.isnan(some)] = ""
        for ranges in cells.tolist():
            stamp, pose = next(heads)
            yield [repr(stamp), *map(repr, pose), *ranges]


def _rows(names: Sequence[str], stamps: NDArray[np.float64], values: NDArray[Any]) -> Rows:
    """The header and, a line a reading, its stamp [n] and its values [n, k]."""
    yield ["stamp", *names]
    for stamp, row in zip(stamps.tolist(), values.tolist(), strict=True):
        yield [repr(stamp), *map(repr, row)]
