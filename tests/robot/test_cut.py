import math

import numpy as np
import pytest

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats import Cut, cut
from moteslam.robot.platform import Platform
from moteslam.robot.recording import (
    ChunkedRanges,
    EncoderStream,
    ImuStream,
    LidarStream,
    OdometryStream,
    Recording,
    RgbdStream,
)

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
    with pytest.raises((ConfigError, InputError)) as caught:
        cut(recording(), Cut(**part))
    assert caught.value.field == field


def test_a_stream_that_is_not_there() -> None:
    with pytest.raises(InputError, match="lidar"):
        cut(Recording("x", Platform(), lidar=recording().lidar), Cut(streams=("imu",)))
