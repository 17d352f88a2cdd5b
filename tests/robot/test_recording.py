"""Streams are immutable and checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.robot.arrays import frozen, given_up
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.trajectory import Trajectory


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
        ({"stamps": np.arange(3)}, r"stamps of int64 \[3\], expected float64"),
        ({"ranges": np.ones((3, 5))}, r"ranges: float64 \[3, 5\], expected float32 \[3, beams\]"),
        ({"ranges": np.ones((5, 3), np.float32)}, r"ranges: ranges \[5, 3\], expected \[3, \.\.\.\]"),
        ({"odometry": np.ones((2, 3))}, r"odometry: odometry \[2, 3\], expected \[3, 3\]"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        lidar(**changes)


def test_an_array_that_is_given_up_is_not_copied() -> None:
    table = np.ones((4, 6), np.float32)
    for values in (np.ones((4, 3), np.float32), table.reshape(8, 3)):
        assert np.shares_memory(frozen(given_up(values)), values)
    assert not table.flags.writeable
    assert not np.shares_memory(frozen(mine := np.ones(3)), mine)


def test_a_callers_arrays_are_neither_frozen_nor_followed() -> None:
    stamps, ranges = np.arange(3.0), np.ones((3, 5), np.float32)
    stream = lidar(stamps=stamps, ranges=ranges[:, :])
    trajectory = Trajectory(stamps, poses := np.zeros((3, 3)))
    stamps[0], ranges[0, 0], poses[0, 0] = -1.0, 7.0, 7.0
    assert stream.stamps[0] == trajectory.stamps[0] == trajectory.poses[0, 0] == 0.0
    assert stream.ranges[0, 0] == 1.0


def test_an_array_that_nobody_can_write_to_is_not_copied() -> None:
    ranges = np.ones((3, 5), np.float32)
    ranges.setflags(write=False)
    assert np.shares_memory(lidar(ranges=ranges).ranges, ranges)
    assert np.shares_memory(lidar(ranges=ranges[:2], stamps=np.arange(2.0)).ranges, ranges)
    hidden = np.ones((3, 5), np.float32)
    view = hidden[:]
    view.setflags(write=False)  # who has the array behind it can write to it still
    assert not np.shares_memory(lidar(ranges=view).ranges, hidden)


@pytest.mark.parametrize(
    ("stream", "message"),
    [
        (lambda: EncoderStream(np.arange(3.0), np.zeros((2, 4), int)), r"counts \[2, 4\], expected \[3, 4\]"),
        (lambda: EncoderStream(np.arange(3.0), np.zeros((3, 2), int)), r"counts \[3, 2\], expected \[3, 4\]"),
        (lambda: OdometryStream(np.arange(3.0), np.zeros((4, 3))), r"poses \[4, 3\], expected \[3, 3\]"),
        (lambda: ImuStream(np.arange(3.0), np.zeros((3, 3)), np.zeros((2, 3))), r"linear_acceleration_g \[2, 3\]"),
        (lambda: ImuStream(np.arange(3.0), np.zeros(3), np.zeros((3, 3))), r"angular_velocity \[3\], expected"),
    ],
)
def test_every_array_has_a_row_for_every_stamp(stream: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        stream()


def test_replace_changes_a_copy() -> None:
    recording = Recording("x", UCSD, encoders=EncoderStream(np.arange(2.0), np.zeros((2, 4), np.int64)))
    other = recording.replace(name="y", encoders=None)
    assert (recording.name, other.name) == ("x", "y")
    assert recording.encoders is not None
    assert other.encoders is None
