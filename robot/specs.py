"""What a robot's sensors are by their data sheets: where they stand, how often and how far they measure.

A figure that is None is not known: of a recording the stream itself states it, and nothing can be simulated with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.fan import too_wide
from moteslam.robot.noise import ClockNoise
from moteslam.robot.section import NotNegative, Number, Positive, Section, Share, Whole

Position = Annotated[Number, Field(ge=-100, le=100)]
Angle = Annotated[Number, Field(ge=-2 * math.pi, le=2 * math.pi)]
Rate = Annotated[Number, Field(gt=0, le=1000)]

MAX_BEAMS = 100_000


@dataclass(frozen=True)
class ScanFigures:
    """What every scan of a lidar has in common.

    Attributes:
        beams: ranges in a scan.
        angle_min: of the first beam, in the lidar's frame [rad].
        angle_increment: between beams [rad], counterclockwise positive.
        rate: scans a second [Hz].
        range_min, range_max: what the sensor can measure [m].
    """

    beams: int
    angle_min: float
    angle_increment: float
    rate: float
    range_min: float
    range_max: float


class LidarSpec(Section):
    """A planar lidar: where it stands on the robot, and what its scans are.

    Attributes:
        x, y, z: forward, left, up, in the robot's frame [m].
        yaw: of its forward axis [rad].
        time_increment: between beams [s]; 0 where it is not known and a scan counts as taken at once.
        beams: ranges in a scan.
        angle_min: of the first beam, in the lidar's frame [rad].
        angle_increment: between beams [rad]; negative for a lidar that turns clockwise.
        rate: scans a second [Hz].
        range_min, range_max: what the sensor can measure [m].
        no_return: what it reports where nothing comes back [m], from ``range_max`` on; several codes are written in
            turns. Where there is none, the format's own is written.
    """

    x: Position = 0.0
    y: Position = 0.0
    yaw: Angle = 0.0
    z: Position = 0.0
    time_increment: Annotated[Number, Field(ge=0, le=0.01)] = 0.0
    beams: Annotated[Whole, Field(ge=1, le=MAX_BEAMS)] | None = None
    angle_min: Angle | None = None
    angle_increment: Angle | None = None
    rate: Rate | None = None
    range_min: Annotated[Number, Field(ge=0, le=5)] | None = None
    range_max: Annotated[Number, Field(gt=0, le=10_000)] | None = None
    no_return: Annotated[tuple[Positive, ...], Field(max_length=100)] = ()

    @field_validator("beams", "angle_min", "angle_increment", "rate", "range_min", "range_max", mode="before")
    @classmethod
    def _none_of_false(cls, value: Any) -> Any:
        return None if value is False else value

    @model_validator(mode="after")
    def _can_be(self) -> LidarSpec:
        if self.angle_increment == 0:
            raise ValueError("angle_increment of 0, expected an angle between beams, negative if it turns clockwise")
        if self.beams is not None and self.angle_increment is not None:
            problem = too_wide(self.beams, self.angle_increment)
            if problem is not None:
                raise ValueError(problem)
        if self.range_max is not None:
            if self.range_min is not None and self.range_min >= self.range_max:
                raise ValueError(f"range_min of {self.range_min:g} m, expected less than {self.range_max:g} m")
            if any(code < self.range_max for code in self.no_return):
                raise ValueError(f"no_return of {min(self.no_return):g} m, expected at least range_max")
        return self

    @property
    def pose(self) -> tuple[float, float, float]:
        """The mount as a planar pose (x, y, yaw)."""
        return (self.x, self.y, self.yaw)

    @property
    def scan(self) -> ScanFigures:
        """What its scans are.

        Raises:
            ConfigError: some of it is not known; the keys are named.
        """
        figures = {key: getattr(self, key) for key in ScanFigures.__dataclass_fields__}
        if missing := [key for key, value in figures.items() if value is None]:
            raise ConfigError(f"{', '.join(missing)} not known, expected a lidar's figures", field="platform.lidar")
        return ScanFigures(**figures)


class EncoderSpec(Section):
    """Wheel counters that reset when read: ``rate`` readings a second [Hz]."""

    rate: Rate


class ImuSpec(Section):
    """A gyro and an accelerometer at the robot's centre: ``rate`` readings a second [Hz]."""

    rate: Rate


class CameraSettings(Section):
    """An RGB-D camera: its rate, noise and limits.

    Attributes:
        rate: frames a second of either camera, when none is lost [Hz].
        gap: probability that the frames after one are lost.
        gap_frames: how many are lost then.
        disparity_noise: standard deviation of a raw disparity before rounding.
        nearest, farthest: depths that it can measure [m].
        dropout: probability that a pixel has no depth.
        grazing: floor met at a smaller slope than this sends nothing back [m/m].
        colour_noise: standard deviation of a colour level.
        clock: of the frames.
    """

    rate: Annotated[Number, Field(gt=0, le=120)]
    nearest: Positive
    farthest: Positive
    gap: Share = 0.0
    gap_frames: Annotated[Whole, Field(ge=0, le=1000)] = 0
    disparity_noise: NotNegative = 0.0
    dropout: Share = 0.0
    grazing: NotNegative = 0.0
    colour_noise: Annotated[Number, Field(ge=0, le=100)] = 0.0
    clock: ClockNoise = ClockNoise()

    @model_validator(mode="after")
    def _can_measure_something(self) -> CameraSettings:
        if self.nearest >= self.farthest:
            raise ValueError(f"nearest of {self.nearest:g} m, expected less than farthest, {self.farthest:g} m")
        return self


class CameraSpec(Section):
    """An RGB-D camera on the robot.

    Attributes:
        x, y, z: where it is, in the robot's frame [m].
        roll, pitch, yaw: how it is turned [rad], down positive.
        sensor: what it is like; None where that is not known.
    """

    x: Position
    y: Position
    z: Position
    roll: Angle
    pitch: Angle
    yaw: Angle
    sensor: CameraSettings | None = None

    @field_validator("sensor", mode="before")
    @classmethod
    def _none_of_false(cls, value: Any) -> Any:
        return None if value is False else value
