"""Streams are immutable and checked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.robot.platform import UCSD
from moteslam.robot.recording import EncoderStream, LidarStream, Recording


def lidar(**changes: Any) -> LidarStream:
    values = {
        "stamps": np.arange(3.0),
        "ranges": np.ones((3, 5), np.float32),
        "angle_min": -1.0,
        "angle_increment": 0.5,
        "range_min": 0.1,
        "range_max": 30.0,
    }
    return LidarStream(**{**values, **changes})


def test_arrays_cannot_be_changed() -> None:
    stream = lidar()
    with pytest.raises(ValueError, match="read-only"):
        stream.ranges[0, 0] = 2
    with pytest.raises(AttributeError):
        stream.range_max = 3  # type: ignore[misc]


def test_angles_are_those_of_the_beams() -> None:
    np.testing.assert_allclose(lidar().angles, [-1, -0.5, 0, 0.5, 1])
    assert len(lidar()) == 3


def test_equal_stamps_are_allowed() -> None:
    assert len(lidar(stamps=np.array([1.0, 1.0, 1.0]))) == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stamps": np.array([0.0, 2.0, 1.0])}, "stamps: stamps go back or are not finite"),
        ({"stamps": np.array([0.0, np.nan, 1.0])}, "stamps: stamps go back or are not finite"),
        ({"stamps": np.arange(3)}, r"stamps of int64 \(3,\), expected float64"),
        ({"ranges": np.ones((3, 5))}, r"ranges of float64 \(3, 5\), expected float32 \[3, beams\]"),
        ({"ranges": np.ones((5, 3), np.float32)}, r"expected float32 \[3, beams\]"),
        ({"odometry": np.ones((2, 3))}, r"odometry \(2, 3\), expected \[3, 3\]"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        lidar(**changes)


def test_replace_changes_a_copy() -> None:
    recording = Recording("x", UCSD, encoders=EncoderStream(np.arange(2.0), np.zeros((2, 4), np.int64)))
    other = recording.replace(name="y", encoders=None)
    assert (recording.name, other.name) == ("x", "y")
    assert recording.encoders is not None
    assert other.encoders is None
