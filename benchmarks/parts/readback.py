"""Recordings written in a format and read back: by how much each stream differs, and what the format states."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording

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


def write_and_read(name: str, folder: Path, recording: Recording) -> Recording:
    """A recording written in the format of this name, and read back."""
    from moteslam.robot.formats import FORMATS, open_recording, write_recording

    path = folder / f"{name}{next(iter(FORMATS[name].endings), '')}"
    write_recording(path, recording, to=name)
    return open_recording(path)


def differences(name: str, recording: Recording, back: Recording) -> dict[str, float]:
    """The largest difference of every field that a format holds: seconds, metres, radians, counts, g.

    It is infinite where the field is missing, has another shape, or has `inf` or `nan` elsewhere.
    """
    theirs = dict(_values(back))
    return {
        field: _difference(field, value, theirs.get(field))
        for field, value in _values(recording)
        if field.partition(".")[0] in HELD[name] and field not in NOT_HELD.get(name, ())
    }


def beyond(name: str, found: dict[str, float]) -> dict[str, float]:
    """The differences that are larger than what the format states."""
    rounding = ROUNDING if name in BAGS else {}
    return {field: value for field, value in found.items() if value > rounding.get(field, 0.0)}


def _values(recording: Recording) -> Iterator[tuple[str, NDArray[Any]]]:
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
