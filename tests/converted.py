"""A short drive with every stream but a camera, and what of it each format gives back: by how much each stream differs,
and what the format states.
"""

from collections.abc import Iterator
from dataclasses import fields
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording

STREAMS = ("lidar", "encoders", "odometry", "imu")
BAGS = ("bag", "rosbag2", "mcap")
HELD = {
    "ucsd": ("lidar", "encoders", "imu"),
    "carmen": ("lidar", "odometry"),
    **dict.fromkeys(("csv", *BAGS), STREAMS),
}
"""The streams that each format that is written holds, of those without images."""
ROUNDING = {
    "odometry.headings": 2 * float(np.spacing(np.pi)),  # through a quaternion
    "imu.linear_acceleration_g": 2 * float(np.spacing(4.0)),  # through m/s^2, of at most 4 g
}
"""The largest difference that docs/reference/formats.md states of each field in bags; other formats round nothing."""
NOT_HELD = {
    "ucsd": ("lidar.odometry",),
    "carmen": ("lidar.figures.range_min",),
    **dict.fromkeys(BAGS, ("lidar.odometry",)),
}
"""Fields of a held stream that have no place in a format."""
WRITTEN = tuple(HELD)
ENDINGS = {"carmen": ".log.gz", "csv": ".toml", "bag": ".bag", "mcap": ".mcap"}
"""Of files; the others are folders, and have to be named."""


def made(form: str, *, clockwise: bool = False) -> Recording:
    """A recording of random numbers, large and small, named ``x``, with all that a format holds."""
    rng, fan = np.random.default_rng(0), (0.5, -0.0123) if clockwise else (-2.1, 0.0123)

    def numbers(count: int, width: int = 3) -> NDArray[np.float64]:
        return rng.uniform(-1, 1, (count, width)) * 10.0 ** rng.integers(-9, 1, (count, width))

    stamps, ticks = 1.6e9 + np.sort(rng.uniform(0, 20, 30)), 1.6e9 + 0.25 * np.arange(80)
    stamps[7] = stamps[6]
    x, heading = np.sort(rng.uniform((-50, -3.1), (50, 3.1), (40, 2)), axis=0).T
    ranges = rng.uniform(0.1, 24.9, (30, 31)).astype(np.float32)
    ranges[rng.uniform(size=ranges.shape) < 0.1] = np.inf
    ranges[rng.uniform(size=ranges.shape) < 0.1] = np.nan
    with_scans = 9.0 * numbers(30) if "lidar.odometry" not in NOT_HELD.get(form, ()) else None
    lidar = LidarSpec(x=0.1, y=-0.2, z=0.3, yaw=0.4, time_increment=1e-5)
    carmen = Platform(name="carmen", length=0.6, width=0.4, lidar=lidar)  # all that its logs state of a robot
    recording = Recording(
        "x",
        carmen if form == "carmen" else UCSD.model_copy(update={"lidar": lidar}),
        lidar=LidarStream(stamps, ranges, *fan, 0.1, 25.0, 1e-5, with_scans),
        encoders=EncoderStream(ticks, rng.integers(-20, 40, (80, 4))),
        odometry=OdometryStream(1.6e9 + 0.5 * np.arange(40), np.column_stack((x, -0.7 * x, heading))),
        imu=ImuStream(ticks, 9.0 * numbers(80), 4.0 * numbers(80)),
    )
    return recording.replace(**{name: None for name in STREAMS if name not in HELD[form]})


def name_of(form: str, stem: str = "drive") -> str:
    """A name for a recording in a format."""
    return stem + ENDINGS.get(form, "")


def to(form: str) -> list[str]:
    """The options that a format needs on the command line."""
    return [] if form in ENDINGS else ["--to", form]


def assert_held(form: str, recording: Recording, back: Recording) -> None:
    """What a format holds is as it states; every stream that it does not hold is not there."""
    assert beyond(form, differences(form, recording, back)) == {}
    for name in STREAMS:
        if name not in HELD[form]:
            assert getattr(back, name) is None


def differences(name: str, recording: Recording, back: Recording) -> dict[str, float]:
    """The largest difference of every field that a format holds: seconds, metres, radians, counts, g.

    It is infinite where the field is missing, has another shape, or has `inf` or `nan` elsewhere.
    """
    theirs = dict(values_of(back))
    return {
        field: _difference(field, value, theirs.get(field))
        for field, value in values_of(recording)
        if field.partition(".")[0] in HELD[name] and field not in NOT_HELD.get(name, ())
    }


def beyond(name: str, found: dict[str, float]) -> dict[str, float]:
    """The differences that are larger than what the format states."""
    rounding = ROUNDING if name in BAGS else {}
    return {field: value for field, value in found.items() if value > rounding.get(field, 0.0)}


def values_of(recording: Recording) -> Iterator[tuple[str, NDArray[Any]]]:
    """Every array and figure of the streams; of poses the places and the headings apart."""
    for name in STREAMS:
        stream = getattr(recording, name)
        for field in fields(stream) if stream is not None else ():
            value = getattr(stream, field.name)
            if isinstance(value, int | float):
                yield f"{name}.figures.{field.name}", np.array([value])
            elif field.name == "poses":
                yield f"{name}.positions", value[:, :2]
                yield f"{name}.headings", value[:, 2]
            elif value is not None:
                yield f"{name}.{field.name}", np.asarray(value[:])


def _difference(field: str, mine: NDArray[Any], theirs: NDArray[Any] | None) -> float:
    if theirs is None or mine.shape != theirs.shape:
        return inf
    if mine.tobytes() == theirs.tobytes():
        return 0.0
    if field.endswith("headings"):
        return float(np.abs(se2.wrap(mine - theirs)).max())
    finite = np.isfinite(mine)
    if (np.isnan(mine) != np.isnan(theirs)).any() or (finite != np.isfinite(theirs)).any():
        return inf
    return float(np.abs(mine[finite].astype(np.float64) - theirs[finite].astype(np.float64)).max(initial=0.0))
