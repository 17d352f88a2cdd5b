"""A recording: what a robot's sensors saw, each stream with its own stamps. There is no truth in it.

Streams are immutable; stamps are float64 seconds and do not decrease. Distinct readings may share a stamp: they are
kept in file order, and nothing may divide by the time between them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.arrays import frozen
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform
from moteslam.robot.ranges import Ranges
from moteslam.robot.summary import Summarised, span
from moteslam.robot.wording import counted, expect_type

_COLUMNS = {"counts": 4, "poses": 3, "odometry": 3, "angular_velocity": 3, "linear_acceleration_g": 3}
"""How many columns the arrays of this name have."""


class _Frozen(Summarised):
    """Makes every array of a dataclass contiguous and read-only, and checks its axes against the stamps."""

    def __post_init__(self) -> None:
        stamps = frozen(self.stamps)  # type: ignore[attr-defined]
        if stamps.ndim != 1 or stamps.dtype != np.float64:
            raise InputError(f"stamps of {stamps.dtype} {list(stamps.shape)}, expected float64 [n]")
        if not np.isfinite(stamps).all() or (np.diff(stamps) < 0).any():
            raise InputError("stamps go back or are not finite, expected rising seconds", field="stamps")
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if not isinstance(value, np.ndarray):
                continue
            columns = _COLUMNS.get(field.name)
            if field.name != "stamps" and (len(value) != len(stamps) or (columns and value.shape[1:] != (columns,))):
                wanted = f"[{len(stamps)}, {columns}]" if columns else f"[{len(stamps)}, ...]"
                raise InputError(f"{field.name} {list(value.shape)}, expected {wanted}", field=field.name)
            object.__setattr__(self, field.name, frozen(value))


@dataclass(frozen=True, eq=False, repr=False)
class LidarStream(_Frozen):
    """Planar scans.

    Attributes:
        stamps: [n] [s], of the first beam.
        ranges: [n, beams] float32 [m]; ``inf`` is no return (nothing within reach), ``nan`` a reading that says
            nothing (below the minimum, an error code). Only finite ranges are endpoints.
        angle_min: of the first beam, in the lidar's frame [rad].
        angle_increment: between beams [rad], counterclockwise positive.
        range_min, range_max: what the sensor can measure [m].
        time_increment: between beams [s]; 0 where it is not known.
        odometry: [n, 3] the robot's odometry pose logged with each scan, where the format logs one.
        sequence: [n] rising in the order in which the scans were taken, where the stamps are known to be wrong about
            it; None where they are right.
        interlace: 1, or of an interlaced lidar k: a scan measures every k-th beam, from another one on each time, and
            the rest of its ranges is ``nan``.
    """

    stamps: NDArray[np.float64]
    ranges: Ranges
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    time_increment: float = 0.0
    odometry: NDArray[np.float64] | None = None
    sequence: NDArray[np.int64] | None = None
    interlace: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = tuple(self.ranges.shape)
        if isinstance(self.interlace, bool) or not isinstance(self.interlace, int) or self.interlace < 1:
            raise InputError(f"{self.interlace!r}, expected a whole number of 1 or more", field="interlace")
        if self.ranges.dtype != np.float32 or len(shape) != 2 or shape[0] != len(self.stamps):
            found = f"{self.ranges.dtype} {list(shape)}"
            raise InputError(f"{found}, expected float32 [{len(self.stamps)}, beams]", field="ranges")
        for name in ("angle_min", "angle_increment", "range_min", "range_max", "time_increment"):
            object.__setattr__(self, name, float(getattr(self, name)))  # of a NumPy scalar, whose text is no number

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def angles(self) -> NDArray[np.float64]:
        """The beams' angles [beams] in the lidar's frame [rad]."""
        return self.angle_min + self.angle_increment * np.arange(self.ranges.shape[1], dtype=np.float64)

    def _summary(self) -> str:
        beams = counted(-(-self.ranges.shape[1] // self.interlace), "beam")
        turns = f" ({self.interlace} interlaced)" if self.interlace > 1 else ""
        return f"{counted(len(self), 'scan')} of {beams}{turns}, {span(self.stamps)}"


@dataclass(frozen=True, eq=False, repr=False)
class EncoderStream(_Frozen):
    """Wheel counters that reset when read.

    Attributes:
        stamps: [n] [s].
        counts: [n, 4] int: change since the last reading of the front right, front left, rear right, rear left wheel.
    """

    stamps: NDArray[np.float64]
    counts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.stamps)

    def _summary(self) -> str:
        return f"{counted(len(self), 'reading')}, {span(self.stamps)}"


@dataclass(frozen=True, eq=False, repr=False)
class OdometryStream(_Frozen):
    """The poses that the robot's own odometry gave: stamps [n] [s], poses [n, 3]."""

    stamps: NDArray[np.float64]
    poses: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamps)

    def _summary(self) -> str:
        return f"{counted(len(self), 'pose')}, {span(self.stamps)}"


@dataclass(frozen=True, eq=False, repr=False)
class ImuStream(_Frozen):
    """Inertial readings.

    Attributes:
        stamps: [n] [s].
        angular_velocity: [n, 3] [rad/s]; column 2 is the yaw rate.
        linear_acceleration_g: [n, 3] in g, as the sensor reports it (9.80665 m/s^2 each).
    """

    stamps: NDArray[np.float64]
    angular_velocity: NDArray[np.float64]
    linear_acceleration_g: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamps)

    def _summary(self) -> str:
        return f"{counted(len(self), 'reading')}, {span(self.stamps)}"


class ImageSource(Protocol):
    """Gives a stream's images where they are not files: held in memory, or drawn when they are asked for."""

    def rgb(self, index: int) -> NDArray[np.uint8]:
        """The colour image [480, 640, 3] of a stamp: red, green, blue."""

    def disparity(self, index: int) -> NDArray[np.uint16]:
        """The raw disparity image [480, 640] of a stamp."""


@dataclass(frozen=True, eq=False, repr=False)
class RgbdStream(Summarised):
    """Camera frames: stamps of the two cameras, which do not fire together, and where their images are.

    Attributes:
        rgb_stamps: [m] of the colour images [s].
        disparity_stamps: [n] of the disparity images [s].
        rgb_files, disparity_files: the images in the order of the stamps, None for one that is missing; empty where
            none are there. ``moteslam.robot.frames.camera_frames`` decodes them as they are needed.
        images: gives the images of all stamps in place of files; None where they are files, or where none are there.
    """

    rgb_stamps: NDArray[np.float64]
    disparity_stamps: NDArray[np.float64]
    rgb_files: tuple[Path | None, ...] = ()
    disparity_files: tuple[Path | None, ...] = ()
    images: ImageSource | None = None

    def _summary(self) -> str:
        colour, disparity = len(self.rgb_stamps), len(self.disparity_stamps)
        return f"{counted(colour, 'colour image')}, {counted(disparity, 'disparity image')}"


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Summarised):
    """What the sensors of one run saw.

    Attributes:
        name: what the recording is called (a file's or scenario's name).
        platform: the robot that carried the sensors.
        lidar, encoders, odometry, imu, rgbd: the streams; None where there is none.
        warnings: what was dropped or repaired on reading.
    """

    name: str
    platform: Platform
    lidar: LidarStream | None = None
    encoders: EncoderStream | None = None
    odometry: OdometryStream | None = None
    imu: ImuStream | None = None
    rgbd: RgbdStream | None = None
    warnings: tuple[Issue, ...] = ()

    def __post_init__(self) -> None:
        expect_type(self.platform, Platform, "platform", "Platform() is one of which nothing is known")
        for name, kind in _STREAMS.items():
            if (stream := getattr(self, name)) is not None:
                expect_type(stream, kind, name)

    def replace(self, **changes: Any) -> Recording:
        """A copy with some of its attributes changed."""
        return replace(self, **changes)

    def _summary(self) -> str:
        streams = [(name, getattr(self, name)) for name in _STREAMS]
        parts = [f"{name}: {stream._summary()}" for name, stream in streams if stream is not None]
        warnings = [counted(len(self.warnings), "warning")] if self.warnings else []
        return "; ".join((repr(self.name), *parts, *warnings))


_STREAMS = {
    "lidar": LidarStream,
    "encoders": EncoderStream,
    "odometry": OdometryStream,
    "imu": ImuStream,
    "rgbd": RgbdStream,
}
"""The streams of a recording by their names."""
