"""Recordings written as bags: what comes back, and what others read."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from converted import made
from hypothesis import given
from hypothesis import strategies as st

from moteslam import open_recording, write_recording
from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.bags.bag import seconds
from moteslam.robot.formats.bags.write import nanoseconds, twists
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.wheel_odometry import wheel_path

KINDS = {"x.bag": "bag", "x.mcap": "mcap", "x": "rosbag2"}
START = 1.6e9

every_kind = pytest.mark.parametrize("name", KINDS)


def lidar_of(ranges: np.ndarray, stamps: np.ndarray) -> LidarStream:
    return LidarStream(stamps, ranges.astype(np.float32), -2.1, 0.0123, 0.1, 25.0, 1e-5)


def written(folder: Path, name: str, recording: Recording) -> Path:
    path = folder / name
    write_recording(path, recording, to=KINDS[name])
    return path


@every_kind
def test_wheels_give_an_odometry_that_does_not_come_back_as_a_stream(tmp_path: Path, name: str) -> None:
    recording = made(KINDS[name]).replace(odometry=None)
    path = written(tmp_path, name, recording)
    again = open_recording(path)
    assert again.odometry is None
    np.testing.assert_array_equal(again.encoders.counts, recording.encoders.counts)
    given = [(m.pose.pose.position, m.pose.pose.orientation) for m in read_by_rosbags(path)["/odom"]]
    poses = np.array([(place.x, place.y, 2 * math.atan2(turn.z, turn.w)) for place, turn in given])
    expected = wheel_path(recording)
    np.testing.assert_array_equal(poses[:, :2], expected[:, :2])
    np.testing.assert_allclose(se2.wrap(poses[:, 2] - expected[:, 2]), 0, atol=1e-14)


@every_kind
def test_rosbags_reads_what_is_written(tmp_path: Path, name: str) -> None:
    recording = made(KINDS[name])
    messages = read_by_rosbags(written(tmp_path, name, recording))
    counts = {topic: len(found) for topic, found in messages.items()}
    assert counts.pop("/clock") == len(np.unique(np.concatenate((recording.lidar.stamps, recording.odometry.stamps))))
    assert counts == {
        "/moteslam/recording": 1,
        "/tf_static": 1,
        "/scan": 30,
        "/odom": 40,
        "/tf": 40,
        "/joint_states": 80,
        "/imu": 80,
    }
    scan = messages["/scan"][7]
    np.testing.assert_array_equal(scan.ranges, recording.lidar.ranges[7])
    assert scan.header.frame_id == "laser"
    assert scan.angle_max == pytest.approx(-2.1 + 30 * 0.0123)
    mount = messages["/tf_static"][0].transforms[0]
    assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "laser")
    assert (mount.transform.translation.x, mount.transform.translation.z) == (0.1, 0.3)
    moved = messages["/tf"][3].transforms[0]
    assert (moved.header.frame_id, moved.child_frame_id) == ("odom", "base_link")
    assert messages["/imu"][0].header.frame_id == "base_link"


def read_by_rosbags(path: Path) -> dict[str, list[Any]]:
    """All messages by topic, as rosbags' own reader makes them, with every definition's hash checked."""
    from rosbags.highlevel import AnyReader

    found: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return found


@given(st.floats(0, 2**31, allow_subnormal=False))
def test_stamps_come_back(stamp: float) -> None:
    back = seconds(nanoseconds(np.array([stamp])))[0]
    assert abs(back - stamp) <= (0 if stamp >= 2**23 else 0.51e-9 + np.spacing(stamp))


def test_velocities_are_differences_of_poses() -> None:
    stamps = np.array([0.0, 0.1, 0.1, 0.3])
    poses = np.array([[0.0, 0.0, math.pi / 2], [0.0, 0.1, math.pi / 2], [0.0, 0.1, math.pi / 2], [0.0, 0.1, 2.0]])
    turn = (2.0 - math.pi / 2) / 0.2
    expected = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, turn]]
    np.testing.assert_allclose(twists(stamps, poses), expected, atol=1e-12)


@every_kind
@pytest.mark.parametrize("stamp", [-1.0, 2.0**31, None])
def test_what_messages_cannot_hold_is_refused(tmp_path: Path, name: str, stamp: float | None) -> None:
    lidar = None if stamp is None else lidar_of(np.ones((1, 3)), np.array([stamp]))
    with pytest.raises(InputError, match="expected"):
        written(tmp_path, name, Recording("x", Platform(), lidar=lidar))
    assert list(tmp_path.iterdir()) == []


def test_poses_of_scans_become_odometry(tmp_path: Path) -> None:
    lidar = lidar_of(np.ones((3, 5)), START + np.arange(3.0))
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [2.0, 0.0, 0.2]])
    with_poses = LidarStream(**{**vars(lidar), "odometry": poses})
    issues = write_recording(tmp_path / "x.bag", Recording("x", Platform(), lidar=with_poses))
    assert [issue.code for issue in issues] == ["scan-poses"]
    again = open_recording(tmp_path / "x.bag")
    np.testing.assert_allclose(again.odometry.poses, poses, atol=1e-15)


def test_the_description_of_a_recording_must_be_whole(tmp_path: Path) -> None:
    path = written(tmp_path, "x.bag", made("bag"))
    path.write_bytes(path.read_bytes().replace(b"streams = [", b"streams # [", 1))
    with pytest.raises(InputError, match=r"/moteslam/recording: .*expected the description of a recording"):
        open_recording(path)
