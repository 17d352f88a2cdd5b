"""Streams are immutable and checked."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.recording import (
    ChunkedRanges,
    EncoderStream,
    ImuStream,
    LidarStream,
    OdometryStream,
    chosen,
    nearest_stamp,
)
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import frozen, given_up


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
        stream.range_max = 3


def test_angles_are_those_of_the_beams() -> None:
    np.testing.assert_allclose(lidar().angles, [-1, -0.5, 0, 0.5, 1])
    assert len(lidar()) == 3


THREE = np.arange(3.0)


@pytest.mark.parametrize(
    ("stream", "field"),
    [
        (lambda: lidar(stamps=np.array([0.0, 2.0, 1.0])), "stamps"),
        (lambda: lidar(stamps=np.arange(3)), "stamps"),
        (lambda: lidar(ranges=np.ones((3, 5))), "ranges"),
        (lambda: lidar(odometry=np.ones((2, 3))), "odometry"),
        (lambda: lidar(interlace=0), "interlace"),
        (lambda: EncoderStream(THREE, np.zeros((3, 2), int)), "counts"),
        (lambda: OdometryStream(THREE, np.zeros((4, 3))), "poses"),
        (lambda: ImuStream(THREE, np.zeros((3, 3)), np.zeros((2, 3))), "linear_acceleration_g"),
        (lambda: Trajectory(THREE, np.zeros((2, 3))), "poses"),
    ],
)
def test_what_does_not_fit_is_refused(stream: Callable[[], object], field: str) -> None:
    with pytest.raises(InputError) as caught:
        stream()
    assert caught.value.field == field


def test_an_array_that_is_given_up_is_not_copied() -> None:
    values = np.ones((4, 3), np.float32)
    assert np.shares_memory(frozen(given_up(values)), values)
    assert not values.flags.writeable
    assert not np.shares_memory(frozen(mine := np.ones(3)), mine)


def test_a_callers_arrays_are_neither_frozen_nor_followed() -> None:
    stamps, ranges = np.arange(3.0), np.ones((3, 5), np.float32)
    stream = lidar(stamps=stamps, ranges=ranges[:, :])
    trajectory = Trajectory(stamps, poses := np.zeros((3, 3)))
    stamps[0], ranges[0, 0], poses[0, 0] = -1.0, 7.0, 7.0
    assert stream.stamps[0] == trajectory.stamps[0] == trajectory.poses[0, 0] == 0.0
    assert stream.ranges[0, 0] == 1.0


def test_the_earlier_of_two_equally_near_is_taken():
    stamps = np.array([0.0, 1.0, 2.0])
    np.testing.assert_array_equal(nearest_stamp(stamps, np.array([-5, 0.4, 0.5, 0.6, 1.5, 9])), [0, 0, 0, 1, 1, 2])
    np.testing.assert_array_equal(nearest_stamp(np.array([3.0]), np.array([0.0, 9.0])), [0, 0])


ALL = np.random.default_rng(3).uniform(0.1, 30, (1000, 7)).astype(np.float32)


class File:
    """Ranges in a file that counts how many scans are read."""

    def __init__(self) -> None:
        self.read = 0

    def load(self, first: int, last: int) -> NDArray[np.float32]:
        self.read += last - first
        return ALL[first:last].copy()


@pytest.mark.parametrize(
    "key",
    [
        0,
        np.int64(517),
        slice(None),
        slice(None, None, -300),
        np.array([999, 3, 3, 511]),
        ALL[:, 0] > 20,
        (5, slice(None, None, 2)),
        (np.array([1, 700]), slice(None)),
    ],
)
def test_chunks_are_indexed_as_an_array_is(key: object) -> None:
    np.testing.assert_array_equal(ChunkedRanges(File().load, 1000, 7)[key], ALL[key])


def test_scans_in_order_are_read_once_and_not_before() -> None:
    file = File()
    ranges = ChunkedRanges(file.load, 1000, 7)
    assert file.read == 0
    for index in range(1000):
        np.testing.assert_array_equal(ranges[index], ALL[index])
    assert file.read == 1000


def test_chosen_scans_are_read_when_they_are_asked_for() -> None:
    file, some = File(), np.array([900, 2, 300])
    few = chosen(ChunkedRanges(file.load, 1000, 7), some)
    assert file.read == 0
    assert few.shape == (3, 7)
    np.testing.assert_array_equal(few[:], ALL[some])
    np.testing.assert_array_equal(chosen(ALL, some)[:], ALL[some])
