"""The robot's body: wheels, lidar, IMU and camera, where they are and what they measure.

A platform comes with a recording (its file, the log's own parameters, or the built-in robot of the format) and can
be overridden by a ``platform.toml``. Facts and sources: ``docs/reference/formats.md``.
"""

from __future__ import annotations

import math
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from pydantic import Field, ValidationError, field_validator

from moteslam.errors import ConfigError
from moteslam.robot.files import write_atomically
from moteslam.robot.section import Number, Section
from moteslam.robot.tables import merged, read_toml
from moteslam.robot.wording import first_complaint, known_keys

Length = Annotated[Number, Field(gt=0, le=100)]
Position = Annotated[Number, Field(ge=-100, le=100)]
Angle = Annotated[Number, Field(ge=-2 * math.pi, le=2 * math.pi)]


class Wheels(Section):
    """The differential drive of two or four wheels.

    Attributes:
        metres_per_count: travel of a wheel for one encoder count [m].
        diameter: of a wheel [m].
        wheel_base: distance between the axles [m].
        track: distance between the left and right wheel centres [m].
        effective_track: the track that explains how it turns [m]; a skid-steered robot's is larger than the drawn.
    """

    metres_per_count: Annotated[Number, Field(ge=1e-7, le=10)] = 0.0022
    diameter: Length = 0.254
    wheel_base: Length = 0.3302
    track: Length = 0.31115
    effective_track: Annotated[Number, Field(ge=0.001, le=100)] = 0.73


class LidarMount(Section):
    """Where the lidar is, in the robot's frame, and how fast it sweeps.

    Attributes:
        x, y, z: forward, left, up [m].
        yaw: of its forward axis [rad].
        time_increment: between beams [s]; 0 where it is not known and a scan counts as taken at once.
    """

    x: Position = 0.0
    y: Position = 0.0
    yaw: Angle = 0.0
    z: Position = 0.0
    time_increment: Annotated[Number, Field(ge=0, le=0.01)] = 0.0

    @property
    def pose(self) -> tuple[float, float, float]:
        """The mount as a planar pose (x, y, yaw)."""
        return (self.x, self.y, self.yaw)


class CameraMount(Section):
    """Where the RGB-D camera is: position [m], roll, pitch (down positive) and yaw [rad], in the robot's frame."""

    x: Position = 0.18
    y: Position = 0.005
    z: Position = 0.36
    roll: Angle = 0.0
    pitch: Angle = 0.36
    yaw: Angle = 0.021


class Platform(Section):
    """A robot: its name, body and sensors.

    Attributes:
        name: what the robot is called.
        length, width: of the body [m].
        wheels: None (``false`` in TOML, which has no other word for it) where only odometry poses are known.
        lidar: where it stands.
        camera: None (``false``) where there is none.
    """

    name: str = "robot"
    length: Length = 0.5
    width: Length = 0.5
    wheels: Wheels | None = None
    lidar: LidarMount = LidarMount()
    camera: CameraMount | None = None

    @property
    def radius(self) -> float:
        """The radius of the circle about the body [m]."""
        return float(np.hypot(self.length, self.width) / 2)

    @field_validator("wheels", "camera", mode="before")
    @classmethod
    def _none_of_false(cls, value: Any) -> Any:
        return None if value is False else value


UCSD = Platform(
    name="ucsd",
    length=0.5842,
    width=0.47625,
    wheels=Wheels(),
    lidar=LidarMount(x=0.30183 - 0.3302 / 2, z=0.51435, time_increment=0.025 / 1440),
    camera=CameraMount(),
)
"""The robot of the UCSD sequences, its origin midway between the axles."""

CARMEN = Platform(name="carmen")
"""A robot of which a CARMEN log states nothing else: odometry poses and a lidar at its centre."""


def read_platform(path: str | PathLike[str], *, base: Platform | None = None) -> Platform:
    """Read a ``platform.toml``.

    Args:
        path: the file.
        base: the robot that it overrides, key by key; a robot of which nothing is known by default.

    Raises:
        ConfigError: not readable, not TOML, an unknown key, or a value out of bounds; file and key are named.
    """
    path = Path(path)
    values = read_toml(path, "a platform.toml")
    try:
        return Platform.model_validate(values if base is None else merged(base.model_dump(), values))
    except ValidationError as error:
        field, problem = first_complaint(
            error, "platform.toml", lambda place: f"expected one of {', '.join(known_keys(Platform, place))}"
        )
        raise ConfigError(problem, file=path, field=field) from error


def write_platform(path: str | PathLike[str], platform: Platform) -> None:
    """Write a platform as TOML with every key; it reads back equal, bit for bit, whatever it overrides."""
    values = platform.model_dump()
    write_atomically(path, tomli_w.dumps({key: False if value is None else value for key, value in values.items()}))


def robot_of(given: Platform | str | PathLike[str] | None, base: Platform) -> Platform:
    """The robot that a caller gives: as it is, by a ``platform.toml`` over the format's own, or that one."""
    if isinstance(given, Platform):
        return given
    return base if given is None else read_platform(given, base=base)
