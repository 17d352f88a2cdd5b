"""A robot: body, wheels and sensors, where they are, what they measure, and what they get wrong.

A platform comes with a recording (its file, the log's own parameters, or the robot that the format is known for), or
is one of the bundled ones (`moteslam.robot.platforms`). Facts and sources: ``docs/reference/platforms.md``. A figure of
a sensor that is None is not known: of a recording the stream itself states it, and nothing can be simulated with it.
"""

import math
from typing import Annotated, Any, NamedTuple, Self, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field, Strict, WrapSerializer, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.noise import ClockNoise, Noise
from moteslam.robot.values import Angle, NotNegative, Number, Positive, Section, Share, Whole, merged

Position = Annotated[Number, Field(ge=-20, le=20)]
Rate = Annotated[Number, Field(gt=0, le=1000)]
Length = Annotated[Number, Field(gt=0, le=100)]
T = TypeVar("T")
Maybe = Annotated[
    T | None,
    BeforeValidator(lambda value: None if value is False else value),
    WrapSerializer(lambda value, plain: False if value is None else plain(value)),
]
"""What may not be there or not be known: ``false`` in TOML, which has no other word for it."""

MAX_BEAMS = 100_000


def too_wide(beams: int, increment: float) -> str | None:
    """What is wrong with a fan that goes round more than once; first and last beam may be the same direction."""
    angle = (beams - 1) * abs(increment)
    if angle <= 2 * math.pi + abs(increment) / 2:
        return None
    return f"{beams} beams {increment:.6g} rad apart are {angle / (2 * math.pi):.2f} turns, expected one at most"


class ScanFigures(NamedTuple):
    """What every scan of a lidar has in common; see `LidarSpec`."""

    beams: int
    angle_min: float
    angle_increment: float
    rate: float
    range_min: float
    range_max: float


class LidarSpec(Section):
    """A planar lidar: where it stands in the robot's frame, and what its scans are."""

    x: Position = 0.0  # forward [m]
    y: Position = 0.0  # left [m]
    yaw: Angle = 0.0  # of its forward axis [rad]
    z: Position = 0.0  # up [m]
    # between beams [s]; 0 where it is not known and a scan counts as taken at once
    time_increment: Annotated[Number, Field(ge=0, le=0.01)] = 0.0
    beams: Maybe[Annotated[Whole, Field(ge=1, le=MAX_BEAMS)]] = None  # ranges in a scan
    angle_min: Maybe[Angle] = None  # of the first beam, in the lidar's frame [rad]
    angle_increment: Maybe[Angle] = None  # between beams [rad]; negative for a lidar that turns clockwise
    rate: Maybe[Rate] = None  # scans a second [Hz]
    range_min: Maybe[Annotated[Number, Field(ge=0, le=5)]] = None  # that it can measure [m]
    range_max: Maybe[Annotated[Number, Field(gt=0, le=10_000)]] = None  # that it can measure [m]
    # what it reports where nothing comes back [m]: 0, or from range_max on; several of these, if they are finite, are
    # written in turns, without one the format's default
    no_return: Annotated[tuple[Annotated[float, Strict(), Field(ge=0)], ...], Field(max_length=100)] = ()

    @model_validator(mode="after")
    def _can_be(self) -> Self:
        if self.angle_increment == 0:
            raise ValueError("angle_increment of 0, expected an angle between beams, negative if it turns clockwise")
        if self.beams and self.angle_increment and (problem := too_wide(self.beams, self.angle_increment)):
            raise ValueError(problem)
        if self.range_max is not None:
            if self.range_min is not None and self.range_min >= self.range_max:
                raise ValueError(f"range_min of {self.range_min:g} m, expected less than {self.range_max:g} m")
            if wrong := [code for code in self.no_return if 0 < code < self.range_max]:
                raise ValueError(f"no_return of {min(wrong):g} m, expected 0, or at least range_max")
        return self

    @property
    def pose(self) -> tuple[float, float, float]:
        """The mount as a planar pose (x, y, yaw)."""
        return (self.x, self.y, self.yaw)

    @property
    def scan(self) -> ScanFigures:
        figures = {key: getattr(self, key) for key in ScanFigures._fields}
        if missing := [key for key, value in figures.items() if value is None]:
            raise ConfigError(f"{', '.join(missing)} not known, expected a lidar's figures", field="platform.lidar")
        return ScanFigures(**figures)


class EncoderSpec(Section):
    """Wheel counters that reset when read."""

    rate: Rate  # readings a second [Hz]


class ImuSpec(Section):
    """A gyro and an accelerometer at the robot's centre."""

    rate: Rate  # readings a second [Hz]


class CameraSettings(Section):
    """An RGB-D camera: its rate, noise and limits."""

    rate: Annotated[Number, Field(gt=0, le=120)]  # frames a second of either camera, when none is lost [Hz]
    nearest: Positive  # depths that it can measure [m]
    farthest: Positive
    gap: Share = 0.0  # probability that the frames after one are lost
    gap_frames: Annotated[Whole, Field(ge=0, le=1000)] = 0  # how many are lost then
    disparity_noise: NotNegative = 0.0  # standard deviation of a raw disparity before rounding
    dropout: Share = 0.0  # probability that a pixel has no depth
    grazing: NotNegative = 0.0  # floor met at a smaller slope than this sends nothing back [m/m]
    colour_noise: Annotated[Number, Field(ge=0, le=100)] = 0.0  # standard deviation of a colour level
    clock: ClockNoise = ClockNoise()

    @model_validator(mode="after")
    def _can_measure_something(self) -> Self:
        if self.nearest >= self.farthest:
            raise ValueError(f"nearest of {self.nearest:g} m, expected less than farthest, {self.farthest:g} m")
        return self


class CameraSpec(Section):
    """An RGB-D camera: where it stands in the robot's frame, and how it is turned, down positive."""

    x: Position  # [m]
    y: Position  # [m]
    z: Position  # [m]
    roll: Angle  # [rad]
    pitch: Angle  # [rad]
    yaw: Angle  # [rad]
    sensor: Maybe[CameraSettings] = None  # what it is like


class Wheels(Section):
    """The differential drive of two or four wheels."""

    metres_per_count: Annotated[Number, Field(ge=1e-7, le=10)]  # travel of a wheel for one encoder count [m]
    diameter: Length  # of a wheel [m]
    # distance between the axles [m]; 0 for two wheels on one axle, which give their counts twice
    wheel_base: Annotated[Number, Field(ge=0, le=100)]
    track: Length  # distance between the left and right wheel centres [m]
    # the track that explains how it turns [m]; a skid-steered robot's is larger than the drawn
    effective_track: Annotated[Number, Field(ge=0.001, le=100)]

    @property
    def sideways_ratio(self) -> float:
        """Stiffness of the contact with the floor sideways over lengthwise, as the effective track shows it."""
        if self.wheel_base == 0:
            return 1.0
        return (self.effective_track - self.track) * self.track / self.wheel_base**2


class Body(Section):
    """The robot as a mass on its wheels."""

    mass: Annotated[Number, Field(gt=0.1, le=1000)]  # [kg]
    wheel_mass: Annotated[Number, Field(ge=0.01, le=100)]  # of a wheel and its motor at the rim, gears included [kg]
    grip: Annotated[Number, Field(gt=0, le=2)]  # friction of a wheel on the floor, 1 = its share of the weight
    # contact force of a wheel for a slip of 1 m/s [N s/m], before the grip gives way
    stiffness: Annotated[Number, Field(gt=0, le=200)]
    wheel_force: Annotated[Number, Field(gt=0, le=1000)]  # the largest of a motor at the rim [N]
    wall_friction: NotNegative  # of the body against what it runs into


class Platform(Section):
    """A robot; what is None is not there or not known, ``false`` in TOML.

    Attributes:
        name, description: what it is called, and what it is in a sentence.
        length, width: of the body.
        top_speed, top_turn_rate: that it can drive and turn with.
        wheels, encoders: None if only odometry poses are known.
        body: its masses and forces.
        lidar, imu, camera: the sensors.
        noise: of the sensors, as data sheets and careful measurements have it.
        as_recorded: of the sensors and their surroundings, as recordings show it; a table holds what differs from
            ``noise``.
    """

    name: str = "robot"
    description: str = ""
    length: Length = 0.5  # [m]
    width: Length = 0.5  # [m]
    top_speed: Maybe[Annotated[Number, Field(gt=0, le=100)]] = None  # [m/s]
    top_turn_rate: Maybe[Annotated[Number, Field(gt=0, le=100)]] = None  # [rad/s]
    wheels: Maybe[Wheels] = None
    body: Maybe[Body] = None
    lidar: LidarSpec = LidarSpec()
    encoders: Maybe[EncoderSpec] = None
    imu: Maybe[ImuSpec] = None
    camera: Maybe[CameraSpec] = None
    noise: Noise = Noise()
    as_recorded: Maybe[Noise] = None

    @property
    def radius(self) -> float:
        """The radius of the circle about the body [m]."""
        return float(np.hypot(self.length, self.width) / 2)

    @model_validator(mode="before")
    @classmethod
    def _over_the_data_sheet(cls, values: Any) -> Any:
        match values:
            case {"as_recorded": dict() as changes}:
                noise = values.get("noise", {})
                noise = noise.model_dump() if isinstance(noise, Noise) else noise
                return {**values, "as_recorded": merged(noise, changes) if isinstance(noise, dict) else changes}
        return values
