"""Wheels as joints, and real bags."""

from pathlib import Path

import numpy as np
import pytest
from made_bags import START, drive, make_bag

from moteslam import open_recording
from moteslam.errors import InputError
from moteslam.robot.formats.bags.motion import angle_of_count
from moteslam.robot.formats.bags.write import Event, header
from moteslam.robot.platforms import bundled_platform
from moteslam.robot.wheel_odometry import wheel_path

TURTLEBOT = bundled_platform("turtlebot3")
STEP = angle_of_count(TURTLEBOT.wheels)


def joints(time: float, names: list[str], angles: list[float]) -> Event:
    stamp = START + round(time * 1e9)
    nothing = np.empty(0)
    values = {"header": header(stamp, ""), "name": names, "position": np.array(angles), "velocity": nothing}
    return Event(stamp, "/joint_states", "sensor_msgs/JointState", {**values, "effort": nothing})


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_wheels_are_read_where_they_are_named(tmp_path: Path, kind: str) -> None:
    names = ["wheel_right_joint", "arm", "wheel_left_joint"]
    moves = [joints(0.1 * i, names, [(100 + 3 * i) * STEP, 9.0, (2 * i + 10) * STEP]) for i in range(5)]
    path = make_bag(tmp_path, [*drive(5), *moves], kind)
    assert open_recording(path, platform="turtlebot3").encoders is None
    encoders = open_recording(path, platform="turtlebot3", topics={"encoders": ("/joint_states",)}).encoders
    np.testing.assert_array_equal(encoders.counts[1:], np.tile([3, 2, 3, 2], (4, 1)))
    np.testing.assert_array_equal(encoders.counts[0], [100, 10, 100, 10])  # less than 1 m: they stood at 0 before


def test_wheels_that_could_be_the_odometry_are_named(tmp_path: Path) -> None:
    scans = [event for event in drive(5) if event.topic in ("/scan", "/tf_static")]
    path = make_bag(tmp_path, [*scans, *(joints(0.1 * i, ["left_wheel", "right_wheel"], [i, i]) for i in range(5))])
    (issue,) = open_recording(path, platform="turtlebot3").warnings
    assert issue.code == "no-odometry"
    assert "/joint_states: left out: --topics encoders=TOPIC" in issue.message


def test_wheels_that_had_gone_far_before_count_from_the_first_reading(tmp_path: Path) -> None:
    moves = [joints(0.1 * i, ["left_wheel", "right_wheel"], [1e6 * STEP, (1e6 + i) * STEP]) for i in range(5)]
    recording = open_recording(
        make_bag(tmp_path, [*drive(5), *moves]), platform="turtlebot3", topics={"encoders": ("/joint_states",)}
    )
    np.testing.assert_array_equal(recording.encoders.counts[0], [0, 0, 0, 0])
    np.testing.assert_array_equal(recording.encoders.counts[1:], np.tile([1, 0, 1, 0], (4, 1)))


@pytest.mark.parametrize(
    ("platform", "names", "problem"),
    [
        (None, ["left_wheel", "right_wheel"], r"/joint_states: joints of wheels, expected a platform with \[wheels\]"),
        ("turtlebot3", ["arm", "gripper"], "/joint_states: .*no wheels .*: arm, gripper"),
    ],
)
def test_joints_that_are_no_wheels_are_refused(
    tmp_path: Path, platform: str | None, names: list[str], problem: str
) -> None:
    path = make_bag(tmp_path, [*drive(5), joints(0, names, [0.0, 0.0])])
    with pytest.raises(InputError, match=problem):
        open_recording(path, platform=platform, topics={"encoders": ("/joint_states",)})


def test_a_turtlebots_bag(data_folder: Path) -> None:
    path = data_folder / "bags" / "fuse_turtlebot3.bag"
    recording = open_recording(path, platform="turtlebot3", topics={"encoders": ("/joint_states",)})
    assert recording.encoders is not None
    assert recording.lidar.ranges.shape == (457, 360)
    assert len(recording.odometry) == 2741
    # the wheels drove the same way that the odometry says
    path_length = np.hypot(*np.diff(wheel_path(recording)[:, :2], axis=0).T).sum()
    assert path_length == pytest.approx(np.hypot(*np.diff(recording.odometry.poses[:, :2], axis=0).T).sum(), rel=0.05)


@pytest.mark.slow
def test_a_museums_bag(data_folder: Path) -> None:
    (path,) = (data_folder / "bags").glob("cartographer_b0*.bag")
    recording = open_recording(path)
    assert recording.odometry is None
    assert recording.lidar.ranges.shape == (345, 1079)
    assert np.isfinite(recording.lidar.ranges[:]).mean() > 0.9
    assert [issue.code for issue in recording.warnings] == ["topics-left", "no-mount"]
    np.testing.assert_allclose(np.linalg.norm(recording.imu.linear_acceleration_g.mean(axis=0)), 1.0, atol=0.02)
