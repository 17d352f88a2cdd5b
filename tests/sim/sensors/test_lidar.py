"""The lidar: where beams end, what noise does to them, and that a scan takes time."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.robot.noise import ClockNoise, LidarNoise
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import LidarStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.lidar import measured, simulate_lidar
from moteslam.sim.world.layout import Layout, Room
from moteslam.sim.world.pieces import Box
from moteslam.sim.world.world import World

ROOM = World.of(Layout(rooms=(Room(corner=(0, 0), size=(12, 9)),), boxes=(Box(centre=(8, 6), size=(1, 1)),)))
MOUNT = UCSD.lidar
WITHOUT_DROPOUT = UCSD.noise.lidar.model_copy(update={"dropout": 0.0})


def moving(start: tuple[float, float, float], velocity: tuple[float, float, float], duration: float) -> Drive:
    """A robot that moves evenly, x and y and heading alike."""
    stamps = np.arange(round(duration * 400) + 1) / 400
    poses = np.asarray(start) + stamps[:, None] * np.asarray(velocity)
    return Drive(stamps, poses, np.tile(np.float64(velocity), (len(stamps), 1)), np.zeros((len(stamps), 4)), "arrived")


def scan(run: Drive, noise: LidarNoise, seed: int = 0, world: World = ROOM) -> LidarStream:
    return simulate_lidar(run, Scene(world), MOUNT, noise, (0.1, run.stamps[-1] - 0.1), np.random.default_rng(seed))


def endpoints(run: Drive, stream: LidarStream, swept: bool) -> np.ndarray:
    """The endpoints [n, beams, 2] in the world, each beam from its own pose, or all from the first beam's."""
    offsets = MOUNT.time_increment * np.arange(1081) * swept
    times = stream.stamps[:, None] + offsets
    robot = np.stack([np.interp(times, run.stamps, run.poses[:, axis]) for axis in range(3)], axis=-1)
    lidar = se2.compose(robot, MOUNT.pose)
    angles = lidar[..., 2] + stream.angles
    return lidar[..., :2] + stream.ranges[..., None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)


@pytest.mark.usefixtures("taichi")
def test_perfect_beams_end_on_the_walls() -> None:
    run = moving((3.0, 3.0, 0.3), (0.8, 0.3, 0.9), 2.0)
    stream = scan(run, LidarNoise())
    assert stream.ranges.shape[1] == 1081
    assert stream.ranges.dtype == np.float32
    assert stream.angles[[0, -1]] == pytest.approx(np.radians([-135, 135]))
    assert np.diff(stream.stamps) == pytest.approx(1 / 40)
    assert np.isfinite(stream.ranges).all()
    swept = ROOM.distance(endpoints(run, stream, swept=True))
    assert swept.max() < 1e-3  # float32 rays over 15 m
    at_once = ROOM.distance(endpoints(run, stream, swept=False))
    assert at_once.max() > 0.05  # turning at 0.9 rad/s for 19 ms, a wall 5 m away


@pytest.mark.usefixtures("taichi")
def test_noisy_beams_end_near_the_walls() -> None:
    run = moving((3.0, 3.0, 0.3), (0.8, 0.3, 0.9), 2.0)
    exact, noisy = scan(run, LidarNoise()), scan(run, UCSD.noise.lidar.model_copy(update={"clock": ClockNoise()}))
    seen = np.isfinite(noisy.ranges)
    assert 1 - seen.mean() == pytest.approx(0.005, abs=0.002)
    error = (noisy.ranges - exact.ranges)[seen]
    assert abs(error.mean()) < 0.001
    assert error.std() == pytest.approx(0.008 + 0.0005 * exact.ranges.mean(), rel=0.1)
    assert np.quantile(ROOM.distance(endpoints(run, noisy, swept=True)[seen]), 0.99) < 0.035


@pytest.mark.usefixtures("taichi")
def test_nothing_within_reach_is_infinite() -> None:
    wall = World.of(Layout(rooms=(Room(corner=(-100, -2), size=(200, 4)),)))
    stream = scan(moving((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5), LidarNoise(), world=wall)
    assert np.isposinf(stream.ranges[:, 540]).all()
    finite = stream.ranges[np.isfinite(stream.ranges)]
    assert 25 < finite.max() <= 30
    assert not np.isnan(stream.ranges).any()


@pytest.mark.usefixtures("taichi")
def test_same_seed_same_ranges() -> None:
    run = moving((3.0, 3.0, 0.3), (0.8, 0.3, 0.9), 0.5)
    first, again, other = (scan(run, UCSD.noise.lidar, seed).ranges.tobytes() for seed in (1, 1, 2))
    assert first == again
    assert first != other


@pytest.mark.parametrize(("metres", "data_sheet"), [(0.5, 0.01), (5.0, 0.01), (10.0, 0.01), (20.0, 0.02), (29.0, 0.03)])
def test_range_noise_is_the_data_sheets(metres: float, data_sheet: float) -> None:
    # UTM-30LX, repeated accuracy: sigma < 10 mm from 0.1 to 10 m, < 30 mm from 10 to 30 m
    ranges = measured(np.full(200_000, metres, np.float32), MOUNT.scan, UCSD.noise.lidar, np.random.default_rng(0))
    spread = np.nanstd(ranges)
    assert data_sheet / 1.5 <= spread <= data_sheet * 1.5
    assert np.nanmean(ranges) == pytest.approx(metres, abs=0.001)


def test_ranges_come_in_millimetres() -> None:
    exact = np.random.default_rng(0).uniform(0.2, 29, 10_000).astype(np.float32)
    ranges = measured(exact, MOUNT.scan, WITHOUT_DROPOUT, np.random.default_rng(1))
    np.testing.assert_allclose(ranges * 1000, np.round(ranges * 1000), atol=2e-3)


def test_limits_of_the_ranges() -> None:
    exact = np.array([0.05, 0.2, 29.99, 30.5, np.inf], np.float32)
    ranges = measured(exact, MOUNT.scan, LidarNoise(), np.random.default_rng(0))
    np.testing.assert_array_equal(ranges, np.array([np.nan, 0.2, 29.99, np.inf, np.inf], np.float32))
    noisy = measured(np.full(10_000, 29.99, np.float32), MOUNT.scan, WITHOUT_DROPOUT, np.random.default_rng(0))
    assert np.isposinf(noisy).any()
    assert noisy[np.isfinite(noisy)].max() <= 30


def test_dropouts_are_unknown_not_far() -> None:
    ranges = measured(np.full(10_000, 5.0, np.float32), MOUNT.scan, LidarNoise(dropout=0.1), np.random.default_rng(0))
    assert np.isnan(ranges).mean() == pytest.approx(0.1, abs=0.01)
    assert not np.isinf(ranges).any()


def test_outliers_are_as_many_and_as_far_as_asked() -> None:
    noise = LidarNoise(range_noise=0.003, outliers=0.1, outlier_noise=0.1)
    off = np.abs(measured(np.full(100_000, 5.0, np.float32), MOUNT.scan, noise, np.random.default_rng(0)) - 5.0)
    assert (off > 0.02).mean() == pytest.approx(0.1 * 0.841, rel=0.05)  # of a normal, this share is beyond 0.2 sigma
    assert off[off > 0.02].max() > 0.25
    assert np.median(off) == pytest.approx(0.6745 * 0.003, rel=0.15)
