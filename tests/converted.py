"""A short drive with every stream but a camera, and what of it each format gives back."""

from __future__ import annotations

from typing import Any

import numpy as np
from parts.readback import HELD, beyond, differences

from moteslam.robot.recording import Recording

WRITTEN = ("ucsd", "carmen", "csv", "bag", "rosbag2", "mcap")
ENDINGS = {"carmen": ".log.gz", "csv": ".toml", "bag": ".bag", "mcap": ".mcap"}
"""Of files; the others are folders, and have to be named."""


def name_of(form: str, stem: str = "drive") -> str:
    """A name for a recording in a format."""
    return stem + ENDINGS.get(form, "")


def to(form: str) -> list[str]:
    """The options that a format needs on the command line."""
    return [] if form in ENDINGS else ["--to", form]


def assert_held(form: str, recording: Recording, back: Recording) -> None:
    """What a format holds is as it states; every stream that it does not hold is not there."""
    assert beyond(form, differences(form, recording, back)) == {}
    for name in ("lidar", "encoders", "odometry", "imu"):
        if name not in HELD[form]:
            assert getattr(back, name) is None


def with_every_stream(recording: Recording, seconds: float = 1.0) -> Recording:
    """The beginning of a simulated recording, with the odometry of its wheels as a stream of its own."""
    from moteslam.robot.formats import Cut, cut
    from moteslam.sim.logged import with_odometry

    return cut(recording.replace(odometry=with_odometry(recording, gyro=True).odometry), Cut(end=seconds))


def array(values: Any) -> np.ndarray:
    """Ranges of any kind as an array."""
    return np.asarray(values[:])
