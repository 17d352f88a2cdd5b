"""A recording: what a robot's sensors saw, each stream with its own stamps. There is no truth in it.

Streams are immutable; stamps are float64 seconds and do not decrease. Distinct readings may share a stamp: they are
kept in file order, and nothing may divide by the time between them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.platform import Platform
from moteslam.robot.values import Issue, Summarised, counted, expect_type, frozen, given_up, span

_COLUMNS = {"counts": 4, "poses": 3, "odometry": 3, "angular_velocity": 3, "linear_acceleration_g": 3}
"""How many columns the arrays of this name have."""

CHUNK = 256  # Scans that are read at a time: 1.1 MB of a lidar of 1081 beams
_KEPT = 4  # Chunks that are kept: neighbouring scans, and two places of a recording that are compared

_GAP, LATEST, _LEAST_GAP = 10.0, 1000, 0.5
"""Readings have a gap between them where they are this many times as far apart as the median of so many latest
intervals, and by more than this [s]."""

SICK_REACH, SICK_CODES = 80.0, 82.0
"""A SICK LMS reaches the first [m]; its codes for no return and errors, 81.83, 81.91 and the like, end below the
second."""


class ChunkedRanges:
    """Ranges that ``load(first, last)`` reads, as float32 [last - first, beams] [m], when they are asked for.

    A few chunks of them are kept.
    """

    dtype = np.dtype(np.float32)

    def __init__(self, load: Callable[[int, int], NDArray[np.float32]], scans: int, beams: int) -> None:
        @lru_cache(_KEPT)
        def chunk(number: int) -> NDArray[np.float32]:
            return given_up(load(number * CHUNK, min((number + 1) * CHUNK, scans)))

        self._chunk, self.shape, self.size = chunk, (scans, beams), scans * beams

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any, /) -> Any:
        if isinstance(key, tuple):
            scans, beams = key
            return self[scans][..., beams]
        if isinstance(key, int | np.integer):
            index = range(len(self))[int(key)]
            return self._chunk(index // CHUNK)[index % CHUNK]
        indices = np.arange(len(self))[key]
        found = np.empty((len(indices), self.shape[1]), np.float32)
        for number in np.unique(indices // CHUNK).tolist():
            here = indices // CHUNK == number
            found[here] = self._chunk(number)[indices[here] % CHUNK]
        return found

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)


Ranges = NDArray[np.float32] | ChunkedRanges
"""Ranges [n, beams] [m], indexed as an array is: by scan, slice, mask or indices, then by beam."""


def chosen(ranges: Ranges, indices: NDArray[np.intp]) -> Ranges:
    """The ranges of some scans [m] in this order; those of a file stay there until they are asked for."""
    if not isinstance(ranges, ChunkedRanges):
        return ranges[indices]
    return ChunkedRanges(lambda first, last: ranges[indices[first:last]], len(indices), ranges.shape[1])


def chunks(ranges: Ranges) -> Iterator[NDArray[np.float32]]:
    """All ranges in order, `CHUNK` scans at a time."""
    for first in range(0, len(ranges), CHUNK):
        yield ranges[first : first + CHUNK]


def phases(ranges: NDArray[np.float32], interlace: int) -> NDArray[np.intp]:
    """At which beam interlaced scans [n, beams] begin [n], below ``interlace``; 0 for a scan that measured nothing."""
    known = ~np.isnan(ranges)
    begins = np.stack([known[:, phase::interlace].any(axis=1) for phase in range(interlace)])
    return np.asarray(begins.argmax(axis=0))


def measured(ranges: NDArray[np.float32], interlace: int) -> NDArray[np.bool_]:
    """Which beams [n, beams] interlaced scans measured, usable reading or not."""
    return np.asarray(np.arange(ranges.shape[1]) % interlace == phases(ranges, interlace)[:, None])


def no_return_limit(ranges: NDArray[np.float32], stated: float | None) -> float:
    """The range [m] from which on a reading is no return, by what a log states and by its ranges, of any shape [m].

    What is stated, unless that lies among the codes of a SICK. Else, if no range is 80 m long, the most frequent of
    those within 0.15 % of the longest (a SICK's codes end at 8.183, 8.187, 8.191 or ten times that), if it is a spike:
    0.2 % of the beams and 10 of them, 5 times as many as at any other value of the upper half, to a tenth of a
    millimetre. (In the logs we know 0.5 to 12 % of the beams are, and no other long range reaches 0.02 %.) Else 80 m.
    """
    if stated is not None:
        return SICK_REACH if SICK_REACH < stated <= SICK_CODES else stated
    finite = ranges[np.isfinite(ranges) & (ranges >= 0)]
    bins = np.rint(finite.astype(np.float64) * 10_000).astype(np.int64)
    if not len(bins) or bins.max() >= SICK_REACH * 10_000:
        return SICK_REACH
    tally = np.bincount(bins)
    used = np.flatnonzero(tally)
    counts = tally[used]
    code = int(np.where(used > used[-1] * (1 - 0.0015), counts, 0).argmax())
    upper = used >= used[-1] / 2
    upper[code] = False
    is_spike = counts[code] >= max(0.002 * len(bins), 10, 5 * counts[upper].max(initial=0))
    return float(finite[bins == used[code]].min()) if is_spike and (used[:code] > 0).any() else SICK_REACH


def nearest_stamp(
    stamps: NDArray[np.float64], times: NDArray[np.float64], *, side: Literal["left", "right"] = "left"
) -> NDArray[np.intp]:
    """The index of the stamp [n] nearest to each time, in the shape of ``times`` [s]; the earlier of two equally near.

    Of several stamps that equal a time the first (``left``) or the last (``right``) is taken.
    """
    after = np.clip(np.searchsorted(stamps, times, side=side), 1, max(len(stamps) - 1, 1))
    before, after = after - 1, np.minimum(after, len(stamps) - 1)
    return np.where(times - stamps[before] <= stamps[after] - times, before, after)


def gaps(stamps: NDArray[np.float64], since: float = -np.inf) -> NDArray[np.bool_]:
    """Before which of rising stamps [n] [s] there is a gap, of those later than ``since``; causal."""
    intervals = stamps[1:] - stamps[:-1]
    gap = np.zeros(len(stamps), np.bool_)
    for k in np.flatnonzero((intervals > _LEAST_GAP) & (stamps[1:] > since)).tolist():
        gap[k + 1] = intervals[k] > _GAP * np.median(intervals[max(0, k + 1 - LATEST) : k + 1])
    return gap


@dataclass(frozen=True, eq=False, repr=False)
class Stream(Summarised):
    """Stamped readings: every array is contiguous and read-only, and has an axis of the stamps [n] [s]."""

    stamps: NDArray[np.float64]
    _reading: ClassVar[str] = "reading"

    def __post_init__(self) -> None:
        stamps = frozen(self.stamps)
        if stamps.ndim != 1 or stamps.dtype != np.float64:
            raise InputError(f"{stamps.dtype} {list(stamps.shape)}, expected float64 [n]", field="stamps")
        if not np.isfinite(stamps).all() or (stamps[1:] < stamps[:-1]).any():
            raise InputError("go back or are not finite, expected rising seconds", field="stamps")
        for field in fields(self):
            if not isinstance(value := getattr(self, field.name), np.ndarray):
                continue
            columns = _COLUMNS.get(field.name)
            if len(value) != len(stamps) or (columns and value.shape[1:] != (columns,)):
                expected = f"[{len(stamps)}, {columns or '...'}]"
                raise InputError(f"{list(value.shape)}, expected {expected}", field=field.name)
            object.__setattr__(self, field.name, frozen(value))

    def __len__(self) -> int:
        return len(self.stamps)

    def take(self, which: NDArray[np.bool_ | np.intp]) -> Self:
        """The readings of some indices [k], or of a mask [n]; ranges of a file stay there."""
        taken: dict[str, Any] = {}
        for field in fields(self):
            if isinstance(value := getattr(self, field.name), np.ndarray | ChunkedRanges):
                taken[field.name] = chosen(value, np.arange(len(self))[which])
        return replace(self, **taken)

    def _summary(self) -> str:
        return f"{counted(len(self), self._reading)}, {span(self.stamps)}"


@dataclass(frozen=True, eq=False, repr=False)
class LidarStream(Stream):
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
            it; None if they are right.
        interlace: 1, or of an interlaced lidar k: a scan measures every k-th beam, from another one on each time, and
            the rest of its ranges is ``nan``.
    """

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
        if self.interlace < 1:
            raise InputError(f"{self.interlace}, expected a whole number of 1 or more", field="interlace")
        if self.ranges.dtype != np.float32 or len(shape) != 2 or shape[0] != len(self.stamps):
            found = f"{self.ranges.dtype} {list(shape)}"
            raise InputError(f"{found}, expected float32 [{len(self.stamps)}, beams]", field="ranges")
        for name in ("angle_min", "angle_increment", "range_min", "range_max", "time_increment"):
            object.__setattr__(self, name, float(getattr(self, name)))  # of a NumPy scalar, whose text is no number

    @property
    def angles(self) -> NDArray[np.float64]:
        """The beams' angles [beams] in the lidar's frame [rad]."""
        return self.angle_min + self.angle_increment * np.arange(self.ranges.shape[1], dtype=np.float64)

    def _summary(self) -> str:
        beams = counted(-(-self.ranges.shape[1] // self.interlace), "beam")
        turns = f" ({self.interlace} interlaced)" if self.interlace > 1 else ""
        return f"{counted(len(self), 'scan')} of {beams}{turns}, {span(self.stamps)}"


@dataclass(frozen=True, eq=False, repr=False)
class EncoderStream(Stream):
    """Wheel counters that reset when read.

    Counts [n, 4] are changes since the last reading of the front right, front left, rear right and rear left wheel.
    """

    counts: NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False)
class OdometryStream(Stream):
    """The poses that the robot's own odometry gave: stamps [n] [s], poses [n, 3]."""

    poses: NDArray[np.float64]
    _reading: ClassVar[str] = "pose"


@dataclass(frozen=True, eq=False, repr=False)
class ImuStream(Stream):
    """Inertial readings [n, 3] about and along x, y, z, in rad/s and in g as the sensor reports it (9.80665 m/s^2)."""

    angular_velocity: NDArray[np.float64]
    linear_acceleration_g: NDArray[np.float64]


class Images(NamedTuple):
    """Gives a stream's images where they are not files: held in memory, or drawn when they are asked for."""

    rgb: Callable[[int], NDArray[np.uint8]]  # [480, 640, 3] of a stamp: red, green, blue
    disparity: Callable[[int], NDArray[np.uint16]]  # [480, 640] of a stamp, raw


@dataclass(frozen=True, eq=False, repr=False)
class RgbdStream(Summarised):
    """Camera frames: stamps of the two cameras, which do not fire together, and where their images are.

    Attributes:
        rgb_stamps, disparity_stamps: of the colour images [m] [s], and of the disparity images [n] [s].
        rgb_files, disparity_files: the images in the order of the stamps, None for one that is missing; empty where
            none are there. ``moteslam.robot.rgbd.camera_frames`` decodes them as they are needed.
        images: gives the images of all stamps in place of files; None if they are files, or missing.
    """

    rgb_stamps: NDArray[np.float64]
    disparity_stamps: NDArray[np.float64]
    rgb_files: tuple[Path | None, ...] = ()
    disparity_files: tuple[Path | None, ...] = ()
    images: Images | None = None

    def _summary(self) -> str:
        colour = counted(len(self.rgb_stamps), "colour image")
        return f"{colour}, {counted(len(self.disparity_stamps), 'disparity image')}"


STREAMS = ("lidar", "encoders", "odometry", "imu", "rgbd")  # The streams of a recording by their names


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Summarised):
    """What the sensors of one run saw.

    Attributes:
        name: what the recording is called (a file's or scenario's name).
        platform: the robot that carried the sensors.
        lidar, encoders, odometry, imu, rgbd: the streams; None if missing.
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

    def replace(self, **changes: Any) -> Self:
        """A copy with some of its attributes changed."""
        return replace(self, **changes)

    def stamps(self) -> dict[str, NDArray[np.float64]]:
        """The stamps of each stream [s], of a camera those of either image, by their names."""
        streams = {name: getattr(self, name) for name in STREAMS[:4]}
        found = {name: stream.stamps for name, stream in streams.items() if stream is not None}
        if self.rgbd is not None:
            found |= {"rgb": self.rgbd.rgb_stamps, "disparity": self.rgbd.disparity_stamps}
        return found

    def with_poses(self, change: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]) -> Self:
        """A copy with the poses of its odometry, and those logged with scans, changed: [n, 3] at stamps [n] [s]."""
        lidar, odometry = self.lidar, self.odometry
        if lidar is not None and lidar.odometry is not None:
            lidar = replace(lidar, odometry=change(lidar.stamps, lidar.odometry))
        if odometry is not None:
            odometry = replace(odometry, poses=change(odometry.stamps, odometry.poses))
        return self.replace(lidar=lidar, odometry=odometry)

    def _summary(self) -> str:
        streams = [(name, getattr(self, name)) for name in STREAMS]
        parts = [f"{name}: {stream._summary()}" for name, stream in streams if stream is not None]
        warnings = [counted(len(self.warnings), "warning")] if self.warnings else []
        return "; ".join((repr(self.name), *parts, *warnings))
