"""The odometry that a base reports is what SLAM integrates from the same streams."""

from __future__ import annotations

import numpy as np
import pytest
from sim_logs import winding
from ucsd_robot import WHEELS

from moteslam.errors import InputError
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, Recording
from moteslam.sim.logged import with_odometry
from moteslam.slam.odometry.dead_reckoning import dead_reckon


def test_a_straight_drive_and_a_turn_on_the_spot_are_exact() -> None:
    wheels = WHEELS.model_copy(update={"metres_per_count": 0.01, "effective_track": 0.5})
    counts = np.array([[7, 7, 7, 7], [10, 10, 10, 10], [25, -25, 25, -25], [10, 10, 10, 10]])
    robot = UCSD.model_copy(update={"wheels": wheels})
    poses = with_odometry(Recording("x", robot, encoders=EncoderStream(np.arange(4.0), counts))).odometry.poses
    np.testing.assert_allclose(poses[:3], [[0, 0, 0], [0.1, 0, 0], [0.1, 0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(poses[3], [0.1 + 0.1 * np.cos(1), 0.1 * np.sin(1), 1.0], atol=1e-15)


@pytest.mark.parametrize("gyro", [False, True])
def test_logged_poses_are_what_slam_integrates_from_the_streams(gyro: bool) -> None:
    dense = winding()
    logged = with_odometry(dense, gyro=gyro)
    expected = dead_reckon(dense if gyro else dense.replace(imu=None))
    assert dead_reckon(logged).poses.tobytes() == expected.poses.tobytes()
    assert logged.lidar is not None
    assert logged.lidar.odometry is not None
    streams = logged.replace(odometry=None, lidar=winding().lidar)  # as a UCSD folder keeps it
    assert dead_reckon(streams).poses.tobytes() == expected.poses.tobytes()


def test_the_gyro_changes_headings_and_is_used_only_where_it_is_asked_for() -> None:
    dense = winding()
    wheels, gyro = with_odometry(dense).odometry.poses, with_odometry(dense, gyro=True).odometry.poses
    assert np.abs(wheels[:, 2] - gyro[:, 2]).max() > 0.01
    np.testing.assert_array_equal(with_odometry(dense.replace(imu=None)).odometry.poses, wheels)


@pytest.mark.parametrize(
    ("changes", "gyro", "line"),
    [
        ({"encoders": None}, False, r"^winding: encoders: no encoder readings, expected at least one$"),
        ({"platform": UCSD.model_copy(update={"wheels": None})}, False, r"^winding: encoders without wheels, expected"),
        ({"imu": None}, True, r"^winding: imu: no gyro, expected at least two readings$"),
    ],
)
def test_what_is_missing_is_named_in_one_line(changes: dict[str, object], gyro: bool, line: str) -> None:
    with pytest.raises(InputError, match=line):
        with_odometry(winding().replace(**changes), gyro=gyro)
