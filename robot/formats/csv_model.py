"""The TOML that describes recordings of one's own: which CSV files, which columns, which units."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from moteslam.robot.tables import Number, Section, Table, read_toml, validated
from moteslam.robot.values import shortened

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
RADIANS = {"rad": 1.0, "deg": math.pi / 180}
RADIANS_PER_SECOND = {"rad/s": 1.0, "deg/s": math.pi / 180}
G = {"g": 1.0, "m/s^2": 1 / 9.80665}
"""Units by their names, in those of a recording."""

TWO_WHEELS = ("left", "right")
FOUR_WHEELS = ("front_right", "front_left", "rear_right", "rear_left")
"""The keys of the wheels, these in the order of a recording's counts."""

STREAMS = ("lidar", "odometry", "encoders", "imu")
"""The tables of a description that are streams."""

RANGE = ".."
"""Between the first and the last column of the ranges."""


def _column(value: Any) -> Any:
    is_number = isinstance(value, int) and not isinstance(value, bool) and value >= 1
    if not is_number and not (isinstance(value, str) and value):
        raise ValueError(f"{shortened(value)}, expected a column: its name in the header, or its number from 1")
    return value


def _platform(value: Any) -> Any:
    if not isinstance(value, str | dict):
        raise ValueError(f"{shortened(value)}, expected a table, or the name of a platform.toml beside this file")
    return value


Column = Annotated[int | str, BeforeValidator(_column)]
Triple = tuple[Column, Column, Column]


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
    range_unit: Literal["m", "cm", "mm", "in"] = "m"
    angle_min: Number | None = None
    angle_increment: Number | None = None
    angle_unit: Literal["rad", "deg"] = "rad"
    range_min: Annotated[Number, Field(ge=0, le=10_000)] | None = None
    range_max: Annotated[Number, Field(gt=0, le=10_000)] | None = None
    odometry: Triple | None = None
    length_unit: Literal["m", "cm", "mm", "in"] = "m"


class OdometryTable(CsvTable):
    """The robot's odometry poses."""

    x: Column
    y: Column
    theta: Column
    length_unit: Literal["m", "cm", "mm", "in"] = "m"
    angle_unit: Literal["rad", "deg"] = "rad"


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
                "columns of some wheels, expected left and right, or front_right, front_left, rear_right and rear_left"
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
    platform: Annotated[str | Table, BeforeValidator(_platform)] = Field(default_factory=dict)
    lidar: LidarTable | None = None
    odometry: OdometryTable | None = None
    encoders: EncoderTable | None = None
    imu: ImuTable | None = None

    @model_validator(mode="after")
    def _has_a_stream(self) -> CsvDescription:
        if all(getattr(self, name) is None for name in STREAMS):
            raise ValueError(f"no stream, expected a table [{'], ['.join(STREAMS)}]")
        return self


def read_description(path: Path) -> CsvDescription:
    """The description in a TOML file."""
    return validated(CsvDescription, read_toml(path, "a description of CSV files"), file=path)
