"""Streams with their own clocks become the motion between scans."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from issues import messages

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats import open_recording
from moteslam.robot.platforms import CARMEN, UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.slam.config import load_preset
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import OdometryPath
from moteslam.slam.inputs.step import steps
from moteslam.slam.inputs.synchronise import bundles, dead_reckon, doubtful_stamps, synchronise, warnings


def circle(*, radius: float = 1.0, speed: float = 0.5, seconds: float = 10.0, imu: bool = True) -> Recording:
    """A robot on a circle: perfect encoders at 40 Hz, gyro at 100 Hz, scans at 40 Hz with another phase."""
    stamps = np.arange(0, seconds, 0.025)
    counts = np.full((len(stamps), 4), speed * 0.025 / UCSD.wheels.metres_per_count)  # not whole: no rounding here
    gyro = np.arange(-0.1, seconds + 0.1, 0.01)
    rates = np.zeros((len(gyro), 3))
    rates[:, 2] = speed / radius + 1e-6 * (-1.0) ** np.arange(len(gyro))  # that repeats its reading hangs
    scans = np.arange(0.01, seconds - 0.1, 0.025)
    return Recording(
        "circle",
        UCSD,
        lidar=LidarStream(scans, np.ones((len(scans), 3), np.float32), -1.0, 1.0, 0.1, 30.0),
        encoders=EncoderStream(stamps, counts),
        imu=ImuStream(gyro, rates, np.zeros_like(rates)) if imu else None,
    )


def made_do(recording: Recording) -> list[str]:
    """What SLAM has to make do with."""
    return list(messages(warnings(recording, synchronise(recording))))


@pytest.mark.parametrize(
    ("config", "within"),
    [(SyncConfig(), 2e-4), (load_preset("paper").sync, 0.5 * 0.025 + 0.04)],  # half an encoder interval
    ids=["interpolate", "paper"],
)
def test_the_odometry_follows_the_circle(config: SyncConfig, within: float):
    path = dead_reckon(circle(), config)
    heading = 0.5 * (path.stamps - path.stamps[0])
    np.testing.assert_allclose(path.poses[:, 0], np.sin(heading), atol=within)
    np.testing.assert_allclose(path.poses[:, 1], 1 - np.cos(heading), atol=within)


def test_steps_add_up_to_dead_reckoning():
    recording = circle()
    motions = [step.motion for step in steps(synchronise(recording))]
    np.testing.assert_allclose(se2.accumulate(np.array(motions)), dead_reckon(recording, SyncConfig()).poses, atol=1e-9)


def test_without_a_gyro_the_wheels_turn_the_robot():
    counts = np.tile([11, 9, 11, 9], (100, 1))  # right faster than left: a left turn
    recording = Recording("w", UCSD, encoders=EncoderStream(np.arange(100) * 0.025, counts))
    path = dead_reckon(recording)
    assert path.poses[-1, 2] == pytest.approx(99 * 2 * 0.0022 / UCSD.wheels.effective_track)


def test_the_gyro_is_integrated_by_the_trapezoid():
    """Of a rate that rises linearly it is exact, however unevenly the readings come; a rectangle is off by degrees."""
    rng = np.random.default_rng(0)
    stamps = np.concatenate(([0.0], np.sort(rng.uniform(0.0, 7.0, 70)), [7.0]))
    acceleration = 0.1
    rates = np.zeros((len(stamps), 3))
    rates[:, 2] = acceleration * stamps
    still = EncoderStream(stamps, np.zeros((len(stamps), 4), np.int64))
    path = dead_reckon(Recording("ramp", UCSD, encoders=still, imu=ImuStream(stamps, rates, np.zeros_like(rates))))
    np.testing.assert_allclose(path.poses[:, 2], acceleration * stamps**2 / 2, atol=1e-9)


def test_scans_that_share_a_stamp_keep_their_own_odometry():
    stamps = np.array([0.0, 1.0, 1.0, 2.0])
    poses = np.array([[0, 0, 0], [1, 0, 0], [1.06, 0, 0], [2, 0, 0]], float)
    lidar = LidarStream(stamps, np.ones((4, 2), np.float32), 0.0, 1.0, 0.0, 30.0, odometry=poses)
    found = list(steps(synchronise(Recording("c", CARMEN, lidar=lidar))))
    np.testing.assert_allclose([step.motion[0] for step in found], [0, 1, 0.06, 0.94])
    assert [step.dt for step in found] == [0, 1, 0, 1]


def test_the_pose_logged_with_a_scan_after_a_gap_of_the_odometry_is_stale():
    """Nothing is recorded for 3 s, and the scan just before the next reading still carries the pose from before."""
    readings = np.r_[np.arange(0, 2.05, 0.1), 5.0, 5.1]
    path = np.column_stack((readings, np.zeros((len(readings), 2))))
    scans = np.array([1.0, 1.95, 2.03, 4.9, 5.05])
    latest = path[np.searchsorted(readings, scans, side="right") - 1]
    lidar = LidarStream(scans, np.ones((5, 2), np.float32), 0.0, 1.0, 0.0, 30.0, odometry=latest)
    recording = Recording("c", CARMEN, lidar=lidar, odometry=OdometryStream(readings, path))
    np.testing.assert_allclose(synchronise(recording).odometry[:, 0], [1.0, 1.9, 2.03, 4.9, 5.0], atol=1e-9)
    alone = Recording("c", CARMEN, lidar=lidar)
    np.testing.assert_array_equal(synchronise(alone).odometry, latest)
    own = np.column_stack((scans + 0.01, np.zeros((5, 2))))  # of each scan itself
    fresh = recording.replace(lidar=replace(lidar, odometry=own))
    np.testing.assert_array_equal(synchronise(fresh).odometry, own)


def test_scans_are_taken_in_the_order_in_which_they_were_taken():
    stamps = np.array([0.0, 1.0, 2.0, 3.0])
    poses = np.array([[0, 0, 0], [2, 0, 0], [1, 0, 0], [3, 0, 0]], float)
    ranges = poses[:, :1].astype(np.float32) + 1
    lidar = LidarStream(stamps, ranges, 0.0, 1.0, 0.0, 30.0, odometry=poses, sequence=np.array([0, 5, 3, 8], np.int64))
    readings = OdometryStream(np.array([0.0, 0.4, 0.8, 2.9, 3.0]), np.zeros((5, 3)))  # a gap says nothing here
    inputs = synchronise(Recording("c", CARMEN, lidar=lidar, odometry=readings))
    assert [float(step.points[0, 0]) for step in steps(inputs)] == [1, 2, 3, 4]
    np.testing.assert_array_equal(inputs.motions[1:, 0], 1)
    np.testing.assert_array_equal(inputs.stamps, [0, 2, 2, 3])
    np.testing.assert_array_equal(inputs.logged, [0, 2, 1, 3])


def test_encoders_that_end_before_the_lidar_are_told():
    recording = circle(seconds=4)
    encoders = recording.encoders
    short = recording.replace(encoders=EncoderStream(encoders.stamps[:80], encoders.counts[:80]))
    assert "before or after all odometry" in " ".join(made_do(short))
    measured = synchronise(short).measured
    assert measured[1:75].all()
    assert not measured[90:].any()
    path = dead_reckon(short)
    np.testing.assert_array_equal(path.poses[-1], path.poses[-2])
    assert made_do(circle(seconds=4)) == []


@pytest.mark.parametrize(("last", "without"), [(400, 0), (385, 0), (100, 297)])
def test_poses_that_end_before_the_lidar_do_not_say_that_the_robot_stands(last: int, without: int):
    stamps = np.arange(0, 10, 0.025)
    poses = np.column_stack((stamps, np.zeros((400, 2))))
    recording = circle().replace(encoders=None, imu=None, odometry=OdometryStream(stamps[:last], poses[:last]))
    assert int((~synchronise(recording).measured).sum()) == without
    assert any("before or after all odometry" in line for line in made_do(recording)) == (without > 0)


@pytest.mark.parametrize(
    ("first", "last", "told"), [(0, 100, []), (4, 97, []), (30, 100, ["begins-late"]), (0, 20, ["ends-early"])]
)
def test_a_way_that_is_driven_without_scans_is_told(first: int, last: int, told: list[str]):
    stamps = np.arange(100) / 5
    path = OdometryPath(stamps, np.column_stack((0.1 * np.arange(100), np.zeros((100, 2)))))
    scans = LidarStream(stamps[first:last], np.ones((last - first, 4), np.float32), -1.5, 1.0, 0.1, 30.0)
    recording = Recording("x", CARMEN, lidar=scans)
    found = doubtful_stamps(recording, path)
    assert [one.code for one in found] == told
    assert all("have nothing of them" in one.message for one in found)
    assert doubtful_stamps(recording, None) == []


CLOCKS = [(1.0, "whole seconds"), (0.1, ""), (100.0, "stands at 0 s")]


@pytest.mark.parametrize(("step", "words"), CLOCKS)
def test_a_clock_that_is_too_coarse_is_named(step: float, words: str):
    stamps = np.floor(np.arange(100) / 10 / step) * step
    scans = LidarStream(stamps, np.ones((100, 4), np.float32), -1.5, 1.0, 0.1, 30.0)
    moves = OdometryStream(stamps, np.zeros((100, 3)))
    found = doubtful_stamps(Recording("x", CARMEN, lidar=scans, odometry=moves), None)
    assert [one.code for one in found] == (["equal-stamps"] * 2 if words else [])
    assert all(words in one.message for one in found)


def test_streams_that_do_not_overlap_are_refused_and_blind_ones_told():
    recording = circle(seconds=4)
    lidar = recording.lidar
    later = LidarStream(lidar.stamps + 3600, lidar.ranges, -1.0, 1.0, 0.1, 30.0)
    with pytest.raises(InputError, match=r"3600 s before them, expected streams that overlap"):
        dead_reckon(recording.replace(lidar=later))
    nothing = LidarStream(lidar.stamps, np.full_like(lidar.ranges, np.inf), -1.0, 1.0, 0.1, 30.0)
    assert "without an endpoint" in made_do(recording.replace(lidar=nothing))[0]
    assert "no gyro" in made_do(recording.replace(imu=None))[0]
    degrees = LidarStream(lidar.stamps, np.ones((len(lidar), 30), np.float32), -1.5, np.radians(0.1), 0.1, 30.0)
    assert "all 30 beams lie within 2.9 degrees" in made_do(recording.replace(lidar=degrees))[0]


def test_wheels_that_turn_the_other_way_than_the_gyro_are_told():
    recording, counts = circle(seconds=15), np.tile([13, 7, 13, 7], (600, 1))
    for order, told in (([0, 1, 2, 3], []), ([1, 0, 3, 2], ["odometry-unfit"])):
        changed = recording.replace(encoders=replace(recording.encoders, counts=counts[:, order]))
        assert [one.code for one in warnings(changed, synchronise(changed))] == told


@pytest.mark.parametrize(("most", "told"), [(127, True), (120, False), (300, False)])
def test_counts_that_were_cut_off_at_a_byte_are_told(most: int, *, told: bool) -> None:
    recording = circle(seconds=4)
    counts = np.minimum(np.random.default_rng(0).integers(80, 200, recording.encoders.counts.shape), most)
    changed = recording.replace(encoders=replace(recording.encoders, counts=counts))
    codes = [one.code for one in warnings(changed, synchronise(changed))]
    assert ("counters-wrap" in codes) is told


@pytest.mark.parametrize(("sequence", "travelled", "heading"), [("20", 95.9, 2.4), ("21", 91.8, -53.0)])
def test_the_real_sequences_end_where_they_are_known_to(
    data_folder: Path, sequence: str, travelled: float, heading: float
):
    """As the paper synchronises; the default is tested as a command."""
    path = dead_reckon(open_recording(data_folder / "ucsd", sequence=sequence), load_preset("paper").sync)
    assert path.length == pytest.approx(travelled, abs=0.2)
    assert np.degrees(path.poses[-1, 2]) == pytest.approx(heading, abs=5)
    assert np.hypot(*(path.poses[-1, :2] - (-2.1, -1.9))) < 1.0 or sequence == "21"


def test_scans_that_come_in_bundles_are_spread_over_the_time_since_the_bundle_before():
    taken = 0.1 * np.arange(200)
    arrived = np.append(taken[4::5], np.inf)[np.arange(200) // 5] + 0.002 * (np.arange(200) % 5)
    arrived[100:] += 7.0  # a pause, over which they are not spread
    recording = circle(imu=False)
    lidar = LidarStream(arrived, np.ones((200, 3), np.float32), -1.0, 1.0, 0.1, 30.0)
    found = bundles(lidar)
    assert "in bundles of about 5," in found.told[1]
    undone = found.undone(recording.replace(lidar=lidar)).lidar.stamps
    np.testing.assert_allclose(undone - taken - 7.0 * (taken > 9.95), 0.008, atol=1e-6)
    assert bundles(replace(lidar, stamps=taken)) is None
    assert bundles(replace(lidar, odometry=np.zeros((200, 3)))) is None


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda stamps, rng: np.sort(stamps + rng.uniform(-0.2, 0.2, len(stamps))), True),
        (lambda stamps, rng: stamps + rng.uniform(-0.02, 0.02, len(stamps)), False),
        (lambda stamps, rng: stamps[rng.random(len(stamps)) > 0.5], False),  # lost scans are no jitter
        (lambda stamps, rng: np.ceil(stamps / 1.6 + 1e-6) * 1.6 + stamps / 100, True),
        (lambda stamps, rng: stamps / 20 + 60 * (stamps > 30) + 60 * (stamps > 50), False),  # a fast lidar that pauses
    ],
    ids=["sorted", "little", "lost", "bundles", "pauses"],
)
def test_stamps_that_jitter_are_told(change, told: bool):
    stamps = change(np.arange(0.0, 80.0, 0.2), np.random.default_rng(0))
    lidar = LidarStream(stamps, np.ones((len(stamps), 3), np.float32), -1.0, 1.0, 0.1, 30.0)
    codes = [issue.code for issue in doubtful_stamps(Recording("drive", UCSD, lidar=lidar), None)]
    assert codes == ["stamps-jitter"] * told
    logged = replace(lidar, odometry=np.zeros((len(stamps), 3)))  # motion does not depend on stamps
    assert not doubtful_stamps(Recording("drive", UCSD, lidar=logged), None)
