"""Recordings of one's own: CSV files, and a TOML that names their columns and units (``docs/guide/own-logs.md``)."""

from __future__ import annotations

import tomllib
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats.csv_model import (
    METRES,
    RADIANS,
    RADIANS_PER_SECOND,
    SECONDS,
    STREAMS,
    TWO_WHEELS,
    CsvDescription,
    CsvTable,
    EncoderTable,
    G,
    ImuTable,
    LidarTable,
    OdometryTable,
    read_description,
)
from moteslam.robot.formats.csv_table import Wanted, read_columns
from moteslam.robot.formats.csv_writer import write_csv
from moteslam.robot.formats.format import Format, Robot, one_sequence
from moteslam.robot.formats.streams import (
    Fan,
    axle_counts,
    counts_of,
    encoder_stream,
    imu_stream,
    lidar_stream,
    odometry_stream,
)
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import platform_of, read_platform
from moteslam.robot.reading import read_text
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.tables import MAX_BYTES, Table
from moteslam.robot.within import file_within

MAX_COUNT = 2**53
"""Ticks stay below it: whole numbers up to there are exact."""

AT_REST = (0.0, 0.0, 1.0)
"""What an accelerometer says of a robot at rest [g]."""


def is_csv_log(path: Path) -> bool:
    """Whether a file is TOML with a table of a stream that names its ``file``."""
    try:
        table = tomllib.loads(read_text(path, "a description of CSV files", limit=MAX_BYTES))
    except (InputError, ValueError, RecursionError):
        return False
    streams = [table.get(name) for name in STREAMS]
    return any(isinstance(stream, dict) and "file" in stream for stream in streams)


def read_csv_log(path: str | PathLike[str], *, platform: Robot = None) -> Recording:
    """Read the CSV files that a TOML describes.

    Broken lines are dropped and counted, as long as there are no more than 3 of them or a tenth of a file.

    Args:
        path: the TOML; its files lie in its folder or below.
        platform: the robot, or a ``platform.toml`` whose keys override those of the description.

    Returns:
        a recording with the streams that are described.

    Raises:
        ConfigError: a description with unknown keys, columns that are not there, or files that lie elsewhere.
        InputError: a file that cannot be read, too much broken, or absurd stamps.
    """
    path = Path(path)
    description = read_description(path)
    given = GivenRobot.read(platform)
    robot = given.over(_platform(path, description))
    issues: list[Issue] = []
    reader = _Reader(path, robot, given.lidar_figures, issues)
    return Recording(
        name=description.name or path.stem,
        platform=robot,
        lidar=None if description.lidar is None else reader.lidar(description.lidar),
        encoders=None if description.encoders is None else reader.encoders(description.encoders),
        odometry=None if description.odometry is None else reader.odometry(description.odometry),
        imu=None if description.imu is None else reader.imu(description.imu),
        warnings=tuple(issues),
    )


def _platform(path: Path, description: CsvDescription) -> Platform:
    if isinstance(description.platform, str):
        return read_platform(file_within(path.resolve().parent, description.platform, file=path, field="platform"))
    try:
        return platform_of(description.platform, file=path)
    except ConfigError as error:
        field = f"platform.{error.field}" if error.field else "platform"
        raise ConfigError(error.problem, file=path, field=field) from error


class _Reader:
    """Reads the streams of one description; what was dropped goes to ``issues``."""

    def __init__(self, path: Path, robot: Platform, given: Table, issues: list[Issue]) -> None:
        self.path, self.robot, self.given, self.issues = path, robot, given, issues

    def lidar(self, table: LidarTable) -> LidarStream:
        """The scans."""
        poses = {} if table.odometry is None else dict(zip(("x", "y", "theta"), table.odometry, strict=True))
        wanted = Wanted(
            {"lidar.stamp": table.stamp, **{f"lidar.odometry.{key}": column for key, column in poses.items()}},
            table.ranges,
            METRES[table.range_unit],
        )
        file, stamps, values, ranges = self._columns("lidar", table, wanted)
        return lidar_stream(
            file,
            table.ranges,
            stamps=stamps,
            ranges=ranges,
            fan=self._fan(table),
            robot=self.robot,
            given=self.given,
            issues=self.issues,
            odometry=_poses(values, table.length_unit, table.angle_unit) if poses else None,
        )

    def odometry(self, table: OdometryTable) -> OdometryStream | None:
        """The odometry poses."""
        wanted = Wanted({f"odometry.{key}": getattr(table, key) for key in ("stamp", "x", "y", "theta")})
        file, stamps, values, _ = self._columns("odometry", table, wanted)
        poses = _poses(values, table.length_unit, table.angle_unit)
        return odometry_stream(file, str(table.stamp), stamps, poses, self.issues)

    def encoders(self, table: EncoderTable) -> EncoderStream:
        """The counts of the wheels."""
        wheels = {f"encoders.{key}": column for key, column in table.wheels.items()}
        file, stamps, values, _ = self._columns("encoders", table, Wanted({"encoders.stamp": table.stamp, **wheels}))
        if (values != np.round(values)).any() or (np.abs(values) >= MAX_COUNT).any():
            raise InputError("not whole numbers, or beyond 2^53, expected ticks", file=file, field="encoders")
        counts = values.astype(np.int64)
        counts = counts_of(counts) if table.running else counts
        if len(wheels) == len(TWO_WHEELS):
            counts = axle_counts(*counts.T)
        return encoder_stream(file, str(table.stamp), stamps, counts, self.robot, self.issues)

    def imu(self, table: ImuTable) -> ImuStream:
        """The inertial readings."""
        rates = {key: getattr(table, key) for key in ("roll_rate", "pitch_rate", "yaw_rate")}
        along = () if table.acceleration is None else table.acceleration
        columns = {key: column for key, column in rates.items() if column is not None}
        columns |= {f"acceleration.{axis}": column for axis, column in zip("xyz", along, strict=False)}
        wanted = Wanted({"imu.stamp": table.stamp, **{f"imu.{key}": column for key, column in columns.items()}})
        file, stamps, values, _ = self._columns("imu", table, wanted)
        found = dict(zip(columns, values.T, strict=True))
        nothing = np.zeros(len(stamps))
        unit = RADIANS_PER_SECOND[table.rate_unit]
        angular = np.stack([found.get(key, nothing) * unit for key in rates], axis=-1)
        if along:
            linear = np.stack([found[f"acceleration.{axis}"] for axis in "xyz"], axis=-1) * G[table.acceleration_unit]
        else:
            linear = np.tile(AT_REST, (len(stamps), 1))
        return imu_stream(file, str(table.stamp), stamps, angular, linear, self.issues)

    def _columns(
        self, stream: str, table: CsvTable, wanted: Wanted
    ) -> tuple[Path, NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]:
        """The file, its stamps [n] [s], the other finite columns [n, k] in its units, and the ranges [n, m] [m]."""
        file = file_within(self.path.resolve().parent, table.file, file=self.path, field=f"{stream}.file")
        columns = read_columns(file, table, wanted, description=self.path, issues=self.issues)
        return file, columns.finite[:, 0] * SECONDS[table.stamp_unit], columns.finite[:, 1:], columns.ranges

    def _fan(self, table: LidarTable) -> Fan:
        """Angles and limits: of the description, else of its robot."""
        spec, unit = self.robot.lidar, RADIANS[table.angle_unit]
        angle_min = spec.angle_min if table.angle_min is None else table.angle_min * unit
        increment = spec.angle_increment if table.angle_increment is None else table.angle_increment * unit
        range_max = spec.range_max if table.range_max is None else table.range_max
        if angle_min is None or not increment or range_max is None:
            raise ConfigError(
                "angle_min, angle_increment (not 0) or range_max missing, expected here or in the platform's lidar",
                file=self.path,
                field="lidar",
            )
        range_min = next((limit for limit in (table.range_min, spec.range_min) if limit is not None), 0.0)
        if range_min >= range_max:
            raise ConfigError(
                f"{range_min:g} m, expected less than range_max, {range_max:g} m",
                file=self.path,
                field="lidar.range_min",
            )
        return Fan(angle_min, increment, range_min, range_max)


def _poses(values: NDArray[np.float64], length: str, angle: str) -> NDArray[np.float64]:
    return values * (METRES[length], METRES[length], RADIANS[angle])


FORMAT = Format(
    "CSV log (a TOML that names files and columns)",
    is_folder=False,
    recognise=is_csv_log,
    read=one_sequence("a CSV log", read_csv_log),
    write=write_csv,
    endings=(".toml",),
)
