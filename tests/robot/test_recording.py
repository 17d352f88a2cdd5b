"""Streams are immutable and checked, shown in one line without their numbers, and cut in time."""

import dataclasses
import importlib
import math
import pkgutil
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refusal

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats import Cut, cut
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import UCSD
from moteslam.robot.raster import Raster
from moteslam.robot.recording import (
    ChunkedRanges,
    EncoderStream,
    ImuStream,
    LidarStream,
    OdometryStream,
    Recording,
    RgbdStream,
    chosen,
    nearest_stamp,
)
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, Summarised, frozen, given_up


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
    with refusal(InputError, field=field):
        stream()


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


STAMPS = np.arange(11) / 2
LIDAR = LidarStream(STAMPS, np.ones((11, 181), np.float32), -1.5, 0.01, 0.1, 30.0)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (Trajectory(STAMPS, np.outer(STAMPS, (1, 0, 0))), "Trajectory(11 poses, 5.0 s, 5.0 m)"),
        (Trajectory(STAMPS[:0], np.zeros((0, 3))), "Trajectory(0 poses, 0.0 s, 0.0 m)"),
        (LIDAR, "LidarStream(11 scans of 181 beams, 5.0 s)"),
        (EncoderStream(STAMPS, np.zeros((11, 4), np.int64)), "EncoderStream(11 readings, 5.0 s)"),
        (RgbdStream(STAMPS, STAMPS[1:]), "RgbdStream(11 colour images, 10 disparity images)"),
        (
            Recording("two\n", UCSD, lidar=LIDAR, warnings=(Issue("gaps", "a gap"),)),
            r"Recording('two\n'; lidar: 11 scans of 181 beams, 5.0 s; 1 warning)",
        ),
        (Recording("none", UCSD), "Recording('none')"),
        (Raster(np.zeros((20, 40), np.int8), 0.05), "Raster(int8[20, 40], 2.0 x 1.0 m in cells of 0.05 m)"),
    ],
)
def test_what_is_shown(value: object, shown: str) -> None:
    assert repr(value) == shown


def test_every_dataclass_with_arrays_that_users_meet_is_summarised() -> None:
    missing = []
    for name in ("robot", "sim", "eval.metrics", "slam.estimate", "slam.texture.floor_map"):
        package = importlib.import_module(f"moteslam.{name}")
        modules = [m.name for m in pkgutil.walk_packages(getattr(package, "__path__", []), f"moteslam.{name}.")]
        modules = [module for module in modules if ".formats.bags." not in module]  # what a bag is on its way
        for module in [package, *map(importlib.import_module, modules)]:
            for kind in vars(module).values():
                if not (dataclasses.is_dataclass(kind) and isinstance(kind, type)) or kind.__name__.startswith("_"):
                    continue
                arrays = any("Array" in str(f.type) or str(f.type) == "Poses" for f in dataclasses.fields(kind))
                if arrays and kind.__repr__ is not Summarised.__repr__:
                    missing.append(f"{kind.__module__}.{kind.__qualname__}")
    assert not missing, "expected Summarised, and dataclass(repr=False)"


RANGES = np.random.default_rng(1).uniform(1, 9, (101, 5)).astype(np.float32)


class Images:
    """Images that say which stamp they are of."""

    def rgb(self, index: int) -> np.ndarray:
        return np.full((480, 640, 3), index, np.uint8)

    def disparity(self, index: int) -> np.ndarray:
        return np.full((480, 640), index, np.uint16)


def recording() -> Recording:
    """Ten seconds from 100 s on: scans ten times a second, wheels twenty times, and so on; wheels begin at 99 s."""
    stamps = 100 + np.arange(101) / 10
    wheels = 99 + np.arange(221) / 20
    poses = np.column_stack((stamps, stamps, np.zeros(101)))
    return Recording(
        "drive",
        Platform(),
        lidar=LidarStream(stamps, RANGES, 0.0, 0.1, 0.1, 10.0, odometry=poses),
        encoders=EncoderStream(wheels, np.ones((221, 4), np.int64)),
        odometry=OdometryStream(stamps, poses),
        imu=ImuStream(stamps, np.zeros((101, 3)), np.zeros((101, 3))),
        rgbd=RgbdStream(stamps[::2], stamps[1::2], images=Images()),
    )


def test_from_a_time_to_a_time_after_the_first_stamp_of_any_stream() -> None:
    part = cut(recording(), Cut(start=3.06, end=5.06))  # from 102.06 to 104.06 s: the wheels begin at 99
    np.testing.assert_array_equal(part.lidar.ranges[:], RANGES[21:41])
    np.testing.assert_allclose(part.lidar.stamps, 100 + np.arange(21, 41) / 10)
    np.testing.assert_array_equal(part.lidar.odometry, recording().lidar.odometry[21:41])
    assert len(part.encoders) == 40
    assert len(part.odometry) == 20
    assert len(part.imu) == 20


def test_files_of_images_stay_with_their_stamps(tmp_path) -> None:
    files = tuple(tmp_path / f"{index}.png" for index in range(4))
    whole = recording().replace(rgbd=RgbdStream(np.arange(4.0), np.arange(4.0) + 0.5, files, files[::-1]))
    part = cut(whole, Cut(start=1, end=2)).rgbd
    assert part.rgb_files == files[1:3]
    assert part.disparity_files == files[::-1][1:2]


def test_every_tenth_scan_and_all_readings_of_the_wheels() -> None:
    part = cut(recording(), Cut(every=10))
    np.testing.assert_array_equal(part.lidar.ranges[:], RANGES[::10])
    assert len(part.encoders) == 221


def test_some_streams() -> None:
    part = cut(recording(), Cut(streams=("lidar", "imu")))
    assert part.lidar is not None
    assert part.imu is not None
    assert part.encoders is None
    assert part.odometry is None
    assert part.rgbd is None


def test_ranges_in_a_file_stay_there() -> None:
    def load(first: int, last: int) -> np.ndarray:
        read.append(last - first)
        return RANGES[first:last].copy()

    read: list[int] = []
    whole = recording()
    lidar = LidarStream(whole.lidar.stamps, ChunkedRanges(load, 101, 5), 0.0, 0.1, 0.1, 10.0)
    part = cut(whole.replace(lidar=lidar), Cut(every=50)).lidar
    assert not read
    np.testing.assert_array_equal(part.ranges[:], RANGES[::50])


@pytest.mark.parametrize(
    ("part", "field"),
    [
        ({"start": -1.0}, "start"),
        ({"start": math.nan}, "start"),
        ({"start": 4.0, "end": 4.0}, "end"),
        ({"every": 0}, "every"),
        ({"streams": ("laser",)}, "streams"),
        ({"start": 60, "end": 70}, "start"),
    ],
)
def test_what_leaves_nothing_is_refused(part: dict[str, object], field: str) -> None:
    with refusal((ConfigError, InputError), field=field):
        cut(recording(), Cut(**part))


def test_a_stream_that_is_not_there() -> None:
    with pytest.raises(InputError, match="lidar"):
        cut(Recording("x", Platform(), lidar=recording().lidar), Cut(streams=("imu",)))
