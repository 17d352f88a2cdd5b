"""Recordings of one's own: CSV files, and a TOML that names their columns and units (``docs/guide/own-logs.md``)."""

import math
from array import array
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from moteslam.errors import ConfigError, InputError
from moteslam.files import file_within
from moteslam.robot.formats import Format, Robot, expect_no_sequence
from moteslam.robot.formats.lines import TextLines
from moteslam.robot.formats.streams import Fan, Sensors
from moteslam.robot.formats.written import FOUR_WHEELS, RATES, write_csv
from moteslam.robot.platform import MAX_BEAMS, Platform
from moteslam.robot.platforms import GivenRobot, platform_of, read_platform
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue, Number, Section, Table, counted, read_toml, shortened, validated

Array = NDArray[np.float64]

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "rad": 1.0, "deg": math.pi / 180}
UNITS |= {"rad/s": 1.0, "deg/s": math.pi / 180, "g": 1.0, "m/s^2": 1 / 9.80665, "": 1.0}
"""By their names, in those of a recording."""

TWO_WHEELS = ("left", "right")
UNIT_OF = {
    **{"x": "length_unit", "y": "length_unit", "theta": "angle_unit"},
    **{"odometry.0": "length_unit", "odometry.1": "length_unit", "odometry.2": "angle_unit"},
    **dict.fromkeys((*TWO_WHEELS, *FOUR_WHEELS), ""),
    **dict.fromkeys(RATES, "rate_unit"),
    **dict.fromkeys(("acceleration.0", "acceleration.1", "acceleration.2"), "acceleration_unit"),
}
"""Columns by their keys, and the key of their unit."""
FIGURES = ("angle_min", "angle_increment", "range_min", "range_max")
STREAMS = ("lidar", "odometry", "encoders", "imu")  # The tables of a description that are streams
RUNNING, FASTEST, JITTER = "encoders.running", 20.0, 4
"""A robot drives no faster [m/s]; totals of one that stands may go to and fro by as many ticks."""
MAX_COUNT = 2**53  # Ticks stay below it: whole numbers up to there are exact
AT_REST = (0.0, 0.0, 1.0)  # What an accelerometer says of a robot at rest [g]


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

    @property
    def columns(self) -> dict[str, tuple[Column, float]]:
        """Of numbers: the columns by their keys, and what is multiplied with each."""
        found: dict[str, tuple[Column, float]] = {}
        for key, unit in UNIT_OF.items():
            name, _, place = key.partition(".")
            if (value := getattr(self, name, None)) is not None:
                found[key] = value[int(place)] if place else value, UNITS[getattr(self, unit, "")]
        return found


class LidarTable(CsvTable):
    """The scans, a line each; in ``ranges`` an empty cell is invalid, ``inf`` is no return.

    Angles are counterclockwise positive; below ``range_min`` [m] a range is invalid, from ``range_max`` [m] on it is
    no return. ``odometry`` are the columns of x, y and theta of the robot's odometry pose at the scan.
    """

    ranges: Annotated[str, Field(pattern=r"^.+\.\..+$")]  # the first and the last column, r0..r359 or 2..361
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

    @model_validator(mode="after")
    def _two_or_four(self) -> Self:
        if tuple(self.columns) not in (TWO_WHEELS, FOUR_WHEELS):
            expected = f"expected {' and '.join(TWO_WHEELS)}, or {', '.join(FOUR_WHEELS)}"
            raise ValueError(f"columns of some wheels, {expected}")
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
    def _has_a_stream(self) -> Self:
        if not any(getattr(self, name) for name in STREAMS):
            raise ValueError(f"no stream, expected a table [{'], ['.join(STREAMS)}]")
        return self


def is_csv_log(path: Path) -> bool:
    """Whether a file is TOML with a table of a stream that names its ``file``, or by its name is meant to be."""
    try:
        table = read_toml(path, "a description of CSV files")
    except ConfigError:
        return path.suffix.lower() == FORMAT.endings[0]
    return any(isinstance(stream := table.get(name), dict) and "file" in stream for name in STREAMS)


def read_csv_log(path: str | PathLike[str], sequence: str | int | None = None, platform: Robot = None) -> Recording:
    """Read the CSV files that a TOML describes; they lie in its folder or below."""
    expect_no_sequence(path, sequence)
    path, given = Path(path), GivenRobot.read(platform)
    description = validated(CsvDescription, read_toml(path, "a description of CSV files"), file=path)
    robot = given.over(_platform(path, description))
    issues: list[Issue] = []
    sensors = Sensors(robot, given.lidar_figures, issues)
    streams: dict[str, Any] = {}
    for name in STREAMS:
        if (table := getattr(description, name)) is None:
            continue
        file, stamps, values, ranges = _read(path, name, table, issues)
        at = str(table.stamp)
        if name == "lidar":
            poses = values if table.odometry else None
            streams[name] = sensors.lidar(file, table.ranges, stamps, ranges, _fan(path, table, robot), poses)
        elif name == "odometry":
            streams[name] = sensors.odometry(file, at, stamps, values)
        elif name == "encoders":
            if (values != np.round(values)).any() or (np.abs(values) >= MAX_COUNT).any():
                raise InputError("not whole numbers, or beyond 2^53, expected ticks", file=file, field=name)
            counts = _counts(path, stamps, values, robot, issues, running=table.running)
            if len(values.T) == len(TWO_WHEELS):
                counts = counts[:, [1, 0, 1, 0]]  # right and left, in front and behind
            streams[name] = sensors.encoders(file, (at, at), stamps, counts)
        else:
            rates = dict(zip(table.columns, values.T, strict=True))
            angular = np.column_stack([rates.get(key, np.zeros(len(stamps))) for key in RATES])
            linear = values[:, -3:] if table.acceleration else np.tile(AT_REST, (len(stamps), 1))
            streams[name] = sensors.imu(file, (at, at), stamps, angular, linear)
    return Recording(description.name or path.stem, robot, warnings=tuple(issues), **streams)


def _counts(
    path: Path, stamps: Array, ticks: Array, robot: Platform, issues: list[Issue], *, running: bool
) -> NDArray[np.int64]:
    """The counts [n, k] since the line before of ticks [n, k]; refused where those of the other kind are given.

    Totals go on and on, in steps that are much like the one before; ticks of lines stay within a range, and as steps of
    totals they go to and fro; as ticks of lines totals are faster than robots drive.
    """
    counts = ticks.astype(np.int64)
    steps = np.diff(counts, axis=0, prepend=counts[:1])
    for half in (2**15, 2**31):  # a counter of 16 or 32 bits that is full begins again
        near = (steps + half) % (2 * half) - half
        if running and np.ptp(counts, axis=0).max() < 2 * half and np.abs(near).sum() < 0.75 * np.abs(steps).sum():
            text = f"{path.name}: counters begin again after {2 * half} ticks: taken as ones that go on"
            issues.append(Issue("counters-wrap", text, int((near != steps).any(axis=1).sum())))
            steps = near
    way, unlike, within = np.abs(steps).sum(), np.abs(np.diff(steps, axis=0)).sum(), np.ptp(counts, axis=0)
    if running and within.sum() < way / 10 and unlike > way / 2 and within.max() > JITTER:
        raise ConfigError("true, but the ticks stay within a range: expected false", file=path, field=RUNNING)
    if not running and robot.wheels is not None and len(stamps) > 1 and unlike < way / 2:
        speed = np.median(np.abs(counts)) * robot.wheels.metres_per_count / max(np.median(np.diff(stamps)), 1e-3)
        if speed > FASTEST:
            problem = f"false, but the ticks go on and on, and each line's are {speed:.3g} m/s: expected true"
            raise ConfigError(problem, file=path, field=RUNNING)
    return steps if running else counts


def _platform(path: Path, description: CsvDescription) -> Platform:
    if isinstance(description.platform, str):
        return read_platform(file_within(path.resolve().parent, description.platform, file=path, field="platform"))
    return platform_of(description.platform, file=path, above="platform")


def _fan(path: Path, table: LidarTable, robot: Platform) -> Fan:
    """Angles and limits: of the description, else of its robot."""
    found = {key: getattr(robot.lidar, key) for key in FIGURES}
    for key in FIGURES:
        if (value := getattr(table, key)) is not None:
            found[key] = value * (UNITS[table.angle_unit] if key.startswith("angle") else 1.0)
    found["range_min"] = found["range_min"] or 0.0
    for key, value in found.items():
        if value is None or (value == 0 and key == "angle_increment"):
            raise ConfigError("missing or 0, expected here or in the platform", file=path, field=f"lidar.{key}")
        if key.startswith("angle") and abs(value) > 2 * np.pi:
            raise ConfigError(f"{value:g} rad, expected a turn at most (angle_unit?)", file=path, field=f"lidar.{key}")
    fan = Fan(**found)
    if fan.range_min >= fan.range_max:
        raise ConfigError(f"{fan.range_min:g} m, expected below range_max", file=path, field="lidar.range_min")
    return fan


def _read(
    path: Path, stream: str, table: CsvTable, issues: list[Issue]
) -> tuple[Path, Array, Array, NDArray[np.float32]]:
    """The file of a stream, its stamps [n] [s], its columns of finite numbers [n, k], and the ranges [n, m] [m].

    Empty lines and comments (``#``) are passed over, broken lines counted; the range of an empty cell is 0.
    """
    file = file_within(path.resolve().parent, table.file, file=path, field=f"{stream}.file")
    lines = TextLines(file)
    mark = None if table.delimiter == " " else table.delimiter.encode()
    rows = (
        (number, [cell.strip().strip(b'"') for cell in line.split(mark)])
        for number, raw in lines
        if (line := raw.strip(b" \r\n" if mark == b"\t" else None)) and not line.startswith(b"#")
    )
    values, found, count = array("d"), array("f"), 0
    header = [cell.decode("utf-8", "replace") for cell in next(rows, (1, []))[1]] if table.header else None
    if header == []:
        raise InputError("no lines, expected a CSV file", file=file)
    named = {"stamp": table.stamp, **{key: column for key, (column, _) in table.columns.items()}}
    finite = [_index(path, f"{stream}.{key}", column, header, file) for key, column in named.items()]
    span, metres = range(0), 1.0
    if isinstance(table, LidarTable):
        span, metres = _span(path, table.ranges, header, file), UNITS[table.range_unit]
        for key, index in zip(named, finite, strict=True):
            if index in span:
                problem = f"column {index + 1} is the {key}, too, expected beams alone in {table.ranges!r}"
                raise ConfigError(problem, file=path, field="lidar.ranges")
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
            lines.drop(number, _not_a_number(cells, header, [*finite, *span]) or str(error)[:100])
            continue
        values.extend(row)
        count += 1
    issues += lines.issues(count, "no line of numbers, expected a CSV file")
    scale = [SECONDS[table.stamp_unit], *(unit for _, unit in table.columns.values())]
    numbers = np.array(values, np.float64).reshape(count, len(scale)) * scale
    return file, numbers[:, 0], numbers[:, 1:], np.array(found, np.float32).reshape(count, len(span))


def _not_a_number(cells: list[bytes], header: list[str] | None, columns: list[int]) -> str:
    """The first cell of some columns that is none, by the name of its column; empty if all are, or some are missing."""
    for index in columns if len(cells) > max(columns) else ():
        try:
            float(cells[index] or b"0")
        except ValueError:
            name = f"column {index + 1}" if header is None else header[index]
            return f"{name[:40]}: {cells[index][:40].decode('utf-8', 'replace')!r}, expected a number"
    return ""


def _index(path: Path, field: str, column: Column, header: list[str] | None, file: Path) -> int:
    """The index from 0 of a column of a file, by its name in the header or by its number."""
    if isinstance(column, int) and 1 <= column <= (MAX_BEAMS if header is None else len(header)):
        return column - 1
    if isinstance(column, str) and header is not None and header.count(column) == 1:
        return header.index(column)
    expected = "a number: it has no header" if header is None else f"one of {shortened(', '.join(header))}"
    raise ConfigError(f"{column!r} is not one column of {file.name}, expected {expected}", file=path, field=field)


def _span(path: Path, ranges: str, header: list[str] | None, file: Path) -> range:
    """The indices of the ranges, from the first to the last column."""
    names = header or ()  # a column may be named by a number
    ends = (int(end[:9]) if end.isdecimal() and end not in names else end for end in ranges.split("..", 1))
    first, last = (_index(path, "lidar.ranges", end, header, file) for end in ends)
    if not 0 <= last - first < MAX_BEAMS:
        raise ConfigError(f"{last - first + 1} beams, expected 1 to {MAX_BEAMS}", file=path, field="lidar.ranges")
    return range(first, last + 1)


FORMAT = Format(
    "CSV log (a TOML that names files and columns)",
    is_folder=False,
    recognise=is_csv_log,
    read=read_csv_log,
    write=write_csv,
    endings=(".toml",),
)
