"""Recordings of one's own: CSV files, and a TOML that names their columns and units (``docs/guide/own-logs.md``)."""

from __future__ import annotations

import math
import tomllib
from array import array
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from moteslam.errors import ConfigError, InputError
from moteslam.robot.files import file_within, read_text
from moteslam.robot.formats import Format, Robot, expect_no_sequence
from moteslam.robot.formats.lines import BrokenLines, TextLines
from moteslam.robot.formats.streams import Fan, encoder_stream, imu_stream, lidar_stream, odometry_stream
from moteslam.robot.formats.written import FOUR_WHEELS, write_csv
from moteslam.robot.platform import MAX_BEAMS, Platform
from moteslam.robot.platforms import GivenRobot, platform_of, read_platform
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.values import MAX_BYTES, Issue, Number, Section, Table, counted, read_toml, shortened, validated

Array = NDArray[np.float64]

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
RADIANS = {"rad": 1.0, "deg": math.pi / 180}
G = {"g": 1.0, "m/s^2": 1 / 9.80665}
"""Units by their names, in those of a recording."""

TWO_WHEELS = ("left", "right")
STREAMS = ("lidar", "odometry", "encoders", "imu")
"""The tables of a description that are streams."""
MAX_COUNT = 2**53
"""Ticks stay below it: whole numbers up to there are exact."""
AT_REST = (0.0, 0.0, 1.0)
"""What an accelerometer says of a robot at rest [g]."""


def _column(value: Any) -> Any:
    is_number = isinstance(value, int) and not isinstance(value, bool) and value >= 1
    if not is_number and not (isinstance(value, str) and value):
        raise ValueError(f"{shortened(value)}, expected a column: its name in the header, or its number from 1")
    return value


def _given_platform(value: Any) -> Any:
    if not isinstance(value, str | dict):
        raise ValueError(f"{shortened(value)}, expected a table, or the name of a platform.toml beside this file")
    return value


Column = Annotated[int | str, BeforeValidator(_column)]
Triple = tuple[Column, Column, Column]
Length = Literal["m", "cm", "mm", "in"]
Angle = Literal["rad", "deg"]


class CsvTable(Section):
    """A CSV file, in the folder of the description or below, plain or gzip, and how it is read.

    Without a header columns are given by number; the delimiter blank stands for any number of blanks and tabs.
    """

    file: Annotated[str, Field(min_length=1)]
    delimiter: Literal[",", ";", "|", "\t", " "] = ","
    header: bool = True
    stamp: Column
    stamp_unit: Literal["s", "ms", "us", "ns"] = "s"


class LidarTable(CsvTable):
    """The scans, a line each; in ``ranges`` an empty cell says nothing, ``inf`` is no return.

    Angles are counterclockwise positive; below ``range_min`` [m] a range says nothing, from ``range_max`` [m] on it is
    no return. ``odometry`` are the columns of x, y and theta of the robot's odometry pose at the scan.
    """

    ranges: Annotated[str, Field(pattern=r"\.\.")]  # the first and the last column, r0..r359 or 2..361
    range_unit: Length = "m"
    angle_min: Number | None = None
    angle_increment: Number | None = None
    angle_unit: Angle = "rad"
    range_min: Annotated[Number, Field(ge=0, le=10_000)] | None = None
    range_max: Annotated[Number, Field(gt=0, le=10_000)] | None = None
    odometry: Triple | None = None
    length_unit: Length = "m"


class OdometryTable(CsvTable):
    """The robot's odometry poses."""

    x: Column
    y: Column
    theta: Column
    length_unit: Length = "m"
    angle_unit: Angle = "rad"


class EncoderTable(CsvTable):
    """Ticks of two wheels on one axle, or of four: ``running`` counters, or the change since the last reading."""

    left: Column | None = None
    right: Column | None = None
    front_right: Column | None = None
    front_left: Column | None = None
    rear_right: Column | None = None
    rear_left: Column | None = None
    running: bool = True

    @property
    def wheels(self) -> dict[str, Column]:
        """The columns by their keys: of two wheels, or of four."""
        columns = {key: getattr(self, key) for key in (*TWO_WHEELS, *FOUR_WHEELS)}
        return {key: column for key, column in columns.items() if column is not None}

    @model_validator(mode="after")
    def _two_or_four(self) -> EncoderTable:
        if tuple(self.wheels) not in (TWO_WHEELS, FOUR_WHEELS):
            raise ValueError(
                f"columns of some wheels, expected {' and '.join(TWO_WHEELS)}, or {', '.join(FOUR_WHEELS)}"
            )
        return self


class ImuTable(CsvTable):
    """The inertial readings, rates counterclockwise positive; the robot is at rest where they say no acceleration."""

    yaw_rate: Column
    roll_rate: Column | None = None
    pitch_rate: Column | None = None
    rate_unit: Literal["rad/s", "deg/s"] = "rad/s"
    acceleration: Triple | None = None
    acceleration_unit: Literal["g", "m/s^2"] = "g"


class CsvDescription(Section):
    """A recording in CSV files: its streams and its robot, a table or the name of a ``platform.toml`` beside it."""

    name: str | None = None
    platform: Annotated[str | Table, BeforeValidator(_given_platform)] = Field(default_factory=dict)
    lidar: LidarTable | None = None
    odometry: OdometryTable | None = None
    encoders: EncoderTable | None = None
    imu: ImuTable | None = None

    @model_validator(mode="after")
    def _has_a_stream(self) -> CsvDescription:
        if not any(getattr(self, name) for name in STREAMS):
            raise ValueError(f"no stream, expected a table [{'], ['.join(STREAMS)}]")
        return self


def is_csv_log(path: Path) -> bool:
    """Whether a file is TOML with a table of a stream that names its ``file``."""
    try:
        table = tomllib.loads(read_text(path, "a description of CSV files", limit=MAX_BYTES))
    except (InputError, OSError, ValueError, RecursionError):
        return False
    streams = [table.get(name) for name in STREAMS]
    return any(isinstance(stream, dict) and "file" in stream for stream in streams)


def read_csv_log(path: str | PathLike[str], sequence: str | int | None = None, platform: Robot = None) -> Recording:
    """Read the CSV files that a TOML describes; they lie in its folder or below."""
    expect_no_sequence(path, sequence)
    path = Path(path)
    description = validated(CsvDescription, read_toml(path, "a description of CSV files"), file=path)
    given = GivenRobot.read(platform)
    issues: list[Issue] = []
    reader = _Reader(path, given.over(_platform(path, description)), given.lidar_figures, issues)
    tables = {name: table for name in STREAMS if (table := getattr(description, name)) is not None}
    streams = {name: getattr(reader, name)(table) for name, table in tables.items()}
    return Recording(description.name or path.stem, reader.robot, warnings=tuple(issues), **streams)


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
        names = zip(("x", "y", "theta"), table.odometry or (), strict=False)
        columns = {f"lidar.odometry.{key}": column for key, column in names}
        file, stamps, values, ranges = self._columns("lidar", table, columns, table.ranges, METRES[table.range_unit])
        return lidar_stream(
            file,
            table.ranges,
            stamps=stamps,
            ranges=ranges,
            fan=self._fan(table),
            robot=self.robot,
            given=self.given,
            issues=self.issues,
            odometry=_poses(values, table) if table.odometry else None,
        )

    def odometry(self, table: OdometryTable) -> OdometryStream | None:
        columns = {f"odometry.{key}": getattr(table, key) for key in ("x", "y", "theta")}
        file, stamps, values, _ = self._columns("odometry", table, columns)
        return odometry_stream(file, str(table.stamp), stamps, _poses(values, table), self.issues)

    def encoders(self, table: EncoderTable) -> EncoderStream:
        wheels = {f"encoders.{key}": column for key, column in table.wheels.items()}
        file, stamps, values, _ = self._columns("encoders", table, wheels)
        if (values != np.round(values)).any() or (np.abs(values) >= MAX_COUNT).any():
            raise InputError("not whole numbers, or beyond 2^53, expected ticks", file=file, field="encoders")
        counts = values.astype(np.int64)
        counts = np.diff(counts, axis=0, prepend=counts[:1]) if table.running else counts
        if len(wheels) == len(TWO_WHEELS):
            left, right = counts.T
            counts = np.stack((right, left, right, left), axis=-1)
        return encoder_stream(file, (str(table.stamp),) * 2, stamps, counts, self.robot, self.issues)

    def imu(self, table: ImuTable) -> ImuStream:
        rates = {key: getattr(table, f"{key}_rate") for key in ("roll", "pitch", "yaw")}
        along = dict(zip("xyz", table.acceleration or (), strict=False))
        columns = {f"imu.{key}_rate": column for key, column in rates.items() if column is not None}
        columns |= {f"imu.acceleration.{axis}": column for axis, column in along.items()}
        file, stamps, values, _ = self._columns("imu", table, columns)
        found = dict(zip(columns, values.T, strict=True))
        angular = np.stack([found.get(f"imu.{key}_rate", np.zeros(len(stamps))) for key in rates], axis=-1)
        linear = np.tile(AT_REST, (len(stamps), 1))
        if along:
            linear = np.stack([found[f"imu.acceleration.{axis}"] for axis in "xyz"], axis=-1)
            linear *= G[table.acceleration_unit]
        angular *= RADIANS[table.rate_unit.removesuffix("/s")]
        return imu_stream(file, (str(table.stamp),) * 2, stamps, angular, linear, self.issues)

    def _columns(
        self, stream: str, table: CsvTable, columns: dict[str, Column], ranges: str = "", metres: float = 1.0
    ) -> tuple[Path, Array, Array, NDArray[np.float32]]:
        """The file, its stamps [n] [s], other columns [n, k] of finite numbers, and the ranges [n, m] [m].

        Empty lines and comments (``#``) are passed over, broken lines counted; the range of an empty cell is 0.
        """
        file = file_within(self.path.resolve().parent, table.file, file=self.path, field=f"{stream}.file")
        lines, broken = TextLines(file), BrokenLines()
        mark = None if table.delimiter == " " else table.delimiter.encode()
        stripped = ((number, line.strip(b" \r" if mark == b"\t" else None)) for number, line in enumerate(lines, 1))
        rows = (
            (number, [cell.strip().strip(b'"') for cell in line.split(mark)])
            for number, line in stripped
            if line and not line.startswith(b"#")
        )
        first: list[bytes] = next(rows, (1, []))[1] if table.header else [b""]
        header = [cell.decode("utf-8", "replace") for cell in first] if table.header else None
        values, found, count = array("d"), array("f"), 0
        if first:
            named = {f"{stream}.stamp": table.stamp, **columns}
            finite = [self._index(name, field, header, file) for field, name in named.items()]
            span = self._span(ranges, header, file) if ranges else range(0)
            last = max(*finite, *span, 0)
            for number, cells in rows:
                try:
                    if len(cells) <= last:
                        raise ValueError(f"{counted(len(cells), 'cell')}, expected at least {last + 1}")
                    if header is not None and mark and len(cells) > len(header) + (cells[-1] == b""):
                        problem = f"{len(cells)} cells under {counted(len(header), 'name')}"
                        raise ValueError(f"{problem}, expected as many (a decimal comma parts a number)")
                    row = [float(cells[index]) for index in finite]
                    if not np.isfinite(row).all():
                        raise ValueError("NaN or infinite, expected finite numbers")
                    found.extend(array("f", [float(cells[index] or b"0") * metres for index in span]))
                except (ValueError, OverflowError) as error:
                    _, is_text, cell = str(error).partition("could not convert string to float: b")
                    broken.add(number, f"{cell[:40]}, expected a number" if is_text else str(error))
                    continue
                values.extend(row)
                count += 1
        self.issues.extend(broken.issues(lines, count, "no line of numbers", "expected a CSV file"))
        cells_of = np.array(values, np.float64).reshape(count, -1)
        stamps = cells_of[:, 0] * SECONDS[table.stamp_unit]
        return file, stamps, cells_of[:, 1:], np.array(found, np.float32).reshape(count, len(span))

    def _fan(self, table: LidarTable) -> Fan:
        """Angles and limits: of the description, else of its robot."""
        spec, unit = self.robot.lidar, RADIANS[table.angle_unit]
        angle_min = spec.angle_min if table.angle_min is None else table.angle_min * unit
        increment = spec.angle_increment if table.angle_increment is None else table.angle_increment * unit
        range_max = spec.range_max if table.range_max is None else table.range_max
        if angle_min is None or not increment or range_max is None:
            problem = "angle_min, angle_increment (not 0) or range_max missing, expected here or in the platform"
            raise ConfigError(problem, file=self.path, field="lidar")
        range_min = next((limit for limit in (table.range_min, spec.range_min) if limit is not None), 0.0)
        if range_min >= range_max:
            problem = f"{range_min:g} m, expected less than range_max, {range_max:g} m"
            raise ConfigError(problem, file=self.path, field="lidar.range_min")
        return Fan(angle_min, increment, range_min, range_max)

    def _index(self, column: Column, field: str, header: list[str] | None, file: Path) -> int:
        """The index from 0 of a column of a file, by its name in the header or by its number."""
        if isinstance(column, int):
            most = MAX_BEAMS if header is None else min(MAX_BEAMS, len(header))
            if column <= most:
                return column - 1
            problem = f"{column}, expected a column of {file.name}, 1 to {most}"
        elif header is None:
            problem = f"{column!r}, expected a number: {file.name} has no header"
        elif header.count(column) == 1:
            return header.index(column)
        else:
            found = "stands twice" if column in header else "is no column"
            problem = f"{column!r} {found} of {file.name}, expected one of {shortened(', '.join(header))}"
        raise ConfigError(problem, file=self.path, field=field)

    def _span(self, ranges: str, header: list[str] | None, file: Path) -> range:
        """The indices of the ranges, from the first to the last column."""
        ends: list[Column] = []
        for end in ranges.split(".."):  # a column may be named by a number
            is_number = end.isdecimal() and len(end) < 10 and not (header and end in header)
            ends.append(int(end) if is_number else end)
        problem = f"{ranges!r}, expected first and last column, r0..r359 or 2..361"
        if len(ends) == 2 and "" not in ends and 0 not in ends:
            first, last = (self._index(end, "lidar.ranges", header, file) for end in ends)
            if 0 <= last - first < MAX_BEAMS:
                return range(first, last + 1)
            problem = f"{last - first + 1} beams, expected 1 to {MAX_BEAMS}"
        raise ConfigError(problem, file=self.path, field="lidar.ranges")


def _poses(values: Array, table: LidarTable | OdometryTable) -> Array:
    return values * (METRES[table.length_unit], METRES[table.length_unit], RADIANS[table.angle_unit])


FORMAT = Format(
    "CSV log (a TOML that names files and columns)",
    is_folder=False,
    recognise=is_csv_log,
    read=read_csv_log,
    write=write_csv,
    endings=(".toml",),
)
