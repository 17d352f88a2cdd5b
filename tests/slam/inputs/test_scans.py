"""Scans as points, de-skewed by the odometry; yaw rates of the gyro as they come: low-pass, and a gyro that hangs."""

from dataclasses import replace

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.slam.inputs import step as thinning
from moteslam.slam.inputs.config import SyncConfig, ThinningConfig
from moteslam.slam.inputs.odometry_path import HANGS, Gyro, LowPass, about_hanging
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.synchronise import synchronise

SPEED, RATE = 0.8, 2.0
"""[m/s], [rad/s]."""
BEAMS, SWEEP = 271, 0.05
"""In a scan, and from its first beam to its last [s]."""
DISTANCE = 4.0
"""Of a straight wall along y [m]."""
MOUNT = (0.2, -0.05, 0.1)


def pose_at(t: np.ndarray) -> np.ndarray:
    """The turning robot's poses [n, 3] at times [n]."""
    angle, radius = RATE * np.asarray(t), SPEED / RATE
    return np.stack((radius * np.sin(angle), radius * (1 - np.cos(angle)), angle), axis=-1)


def turning(*, in_stream: bool = True, in_platform: bool = False, sweep: float = SWEEP) -> Recording:
    """A robot that turns past a wall; the time between beams is given by the stream, the platform, or not at all."""
    increment = SWEEP / (BEAMS - 1)
    angles = np.linspace(-1.2, 1.2, BEAMS)
    stamps = np.array([0.1, 0.2, 0.3])
    ranges = np.empty((3, BEAMS), np.float32)
    for scan, stamp in enumerate(stamps):
        lidar = se2.compose(pose_at(stamp + sweep * np.linspace(0, 1, BEAMS)), np.array(MOUNT))
        towards = np.cos(lidar[:, 2] + angles)
        with np.errstate(divide="ignore"):
            ranges[scan] = np.where(towards > 0.3, (DISTANCE - lidar[:, 0]) / towards, np.inf)
    clock = np.arange(0, 0.5, 0.005)
    x, y, yaw = MOUNT
    return Recording(
        "turning",
        Platform(lidar=LidarSpec(x=x, y=y, yaw=yaw, time_increment=increment if in_platform else 0.0)),
        lidar=LidarStream(
            stamps, ranges, angles[0], angles[1] - angles[0], 0.1, 30.0, time_increment=increment if in_stream else 0.0
        ),
        odometry=OdometryStream(clock, pose_at(clock)),
    )


def off_the_wall(recording: Recording, config: SyncConfig) -> float:
    """How far the farthest endpoint is from the wall [m]."""
    scans, stamps = synchronise(recording, config).scans, recording.lidar.stamps
    points = [se2.transform_points(pose_at(stamp), scans.points(k)) for k, stamp in enumerate(stamps)]
    return max(float(np.abs(p[:, 0] - DISTANCE).max()) for p in points)


@pytest.mark.parametrize(("in_stream", "in_platform"), [(True, False), (False, True), (True, True)])
def test_a_straight_wall_is_straight_to_a_turning_robot(in_stream: bool, in_platform: bool):
    recording = turning(in_stream=in_stream, in_platform=in_platform)
    assert off_the_wall(recording, SyncConfig()) < 1e-3
    assert off_the_wall(recording, SyncConfig(deskew=False)) > 0.2


@pytest.mark.parametrize("which", [slice(None, 66), slice(None, 58), slice(22, None), slice(36, None)])
def test_in_a_sweep_that_odometry_does_not_cover_the_robot_moves_as_nearest_to_it(which: slice) -> None:
    recording = turning()
    recording = recording.replace(odometry=recording.odometry.take(np.arange(100)[which]))
    assert off_the_wall(recording, SyncConfig()) < 5e-3


def test_a_sweep_without_time_is_left_as_it_is():
    recording = turning(in_stream=False, sweep=0.0)
    on, off = synchronise(recording, SyncConfig()).scans, synchronise(recording, SyncConfig(deskew=False)).scans
    for scan in range(3):
        np.testing.assert_array_equal(on.points(scan), off.points(scan))
    assert off_the_wall(recording, SyncConfig()) < 1e-5


def test_only_returns_within_the_range_are_points():
    recording = turning()
    ranges = recording.lidar.ranges
    scans = synchronise(recording, SyncConfig(), max_range=5.0).scans
    assert [len(scans.points(k)) for k in range(3)] == (ranges <= 5.0).sum(axis=1).tolist()
    assert not (ranges <= 5.0).all()
    assert scans.points(0).dtype == np.float32
    np.testing.assert_array_equal(scans.origin, MOUNT[:2])


def test_one_beam_and_none():
    lidar = LidarStream(np.array([0.0]), np.array([[2.0]], np.float32), 0.0, 0.1, 0.1, 30.0, time_increment=0.1)
    poses = OdometryStream(np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [1, 0, 1]]))
    recording = Recording("one", Platform(), lidar=lidar, odometry=poses)
    np.testing.assert_array_equal(synchronise(recording, SyncConfig()).scans.points(0), [[2.0, 0.0]])
    blind = replace(lidar, ranges=np.full((1, 9), np.inf, np.float32))
    assert synchronise(recording.replace(lidar=blind), SyncConfig()).scans.points(0).shape == (0, 2)


@pytest.mark.usefixtures("taichi")
def test_scans_thinned_together_are_those_thinned_alone() -> None:
    scans, config = synchronise(turning(), SyncConfig()).scans, ThinningConfig()
    found = thinning.thin_some(scans, [2, 0, 1], config)
    for scan, index in zip(found, (2, 0, 1), strict=True):
        alone = thinning.thin(scans.points(index), scans.origin, config)
        np.testing.assert_array_equal(scan.points, alone.points)
        np.testing.assert_array_equal(scan.joined, alone.joined)


def test_beams_that_nothing_answered_reach_the_largest_range() -> None:
    recording = turning()
    ranges = recording.lidar.ranges.copy()
    ranges[0, :3] = np.nan, 1.0, np.inf
    lidar = replace(recording.lidar, ranges=ranges)
    for reach, expected in ((np.inf, 30.0), (20.0, 20.0)):
        scans = Scans(lidar, recording.platform.lidar, max_range=reach)
        rays = scans.silent(0) - scans.origin
        assert len(rays) == np.isinf(ranges[0]).sum()
        np.testing.assert_allclose(np.hypot(*rays.T), expected, rtol=1e-5)
        assert np.arctan2(*rays[0, ::-1]) == pytest.approx(lidar.angles[2] + MOUNT[2], abs=1e-5)


def test_the_low_pass_is_scipys_butterworth_whatever_comes_later():
    from scipy.signal import butter, sosfilt, sosfilt_zi

    def low_pass(values: np.ndarray, stamps: np.ndarray, cut_off: float) -> np.ndarray:
        passing = LowPass(cut_off)
        return np.array([passing.of(*each) for each in zip(values.tolist(), stamps.tolist(), strict=True)])

    values, stamps = np.random.default_rng(0).standard_normal(500), 5.0 + np.arange(500) / 100
    sections = butter(1, 10, fs=100, output="sos")
    expected, _ = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])
    np.testing.assert_allclose(low_pass(values, stamps, 10), expected, atol=1e-12)
    late = stamps + np.where(np.arange(500) > 300, 2.0, 0.0)
    assert low_pass(values, late, 10)[:301].tobytes() == low_pass(values, stamps, 10)[:301].tobytes()
    np.testing.assert_array_equal(low_pass(values, stamps, 0), values)
    np.testing.assert_array_equal(low_pass(values, stamps, 51), values)  # above half the rate


@pytest.mark.parametrize("config", [SyncConfig(), SyncConfig(low_pass_hz=10.0)], ids=["as it is", "low-pass"])
def test_a_gyro_that_repeats_a_yaw_rate_hangs_and_the_wheels_say_how_the_robot_turns(config: SyncConfig) -> None:
    rng, stamps = np.random.default_rng(1), 1e9 + np.arange(3000) / 100
    rates = 0.3 + 0.01 * rng.standard_normal(3000)
    rates[1000:2000] = rates[1000]
    hangs = stamps[1000] + HANGS
    turns = []
    for at_a_time in (1, 7, 3000):
        gyro = Gyro(config)
        for first in range(0, 3000, at_a_time):
            gyro.add(stamps[first : first + at_a_time], rates[first : first + at_a_time, None])
        ends = stamps[::10]
        turns.append(gyro.turns(ends, np.full(len(ends) - 1, -1.0)))
        assert gyro.hung == [(stamps[1000], stamps[1999])]
        assert gyro.heard == stamps[-1]
        by_wheels = turns[-1] == -1.0
        assert not by_wheels[ends[1:] < hangs - 0.11].any()
        assert by_wheels[(ends[1:] > hangs + 0.11) & (ends[1:] < stamps[1999])].all()
        assert not by_wheels[ends[1:] > stamps[2010]].any()
    assert turns[0].tobytes() == turns[1].tobytes() == turns[2].tobytes()
    (issue,) = about_hanging(gyro.hung)
    assert issue.code == "no-gyro"
    assert "from 1000000010.00 to 1000000019.99 s" in issue.message


@pytest.mark.parametrize(
    "rates",
    [
        np.zeros(3000),  # of a robot that stands
        np.repeat(np.random.default_rng(2).standard_normal(20), 150),  # ten times as slow as it is asked
        np.round(np.sin(np.arange(3000) / 100), 1),  # coarse
    ],
    ids=["at rest", "slow", "coarse"],
)
def test_a_gyro_that_repeats_what_it_measures_does_not_hang(rates: np.ndarray) -> None:
    gyro = Gyro(SyncConfig())
    gyro.add(np.arange(3000) / 100, rates[:, None])
    assert not gyro.hung
    assert len(gyro) == 3000
    assert about_hanging(gyro.hung) == ()
