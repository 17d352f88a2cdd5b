"""The filters in a room small enough to reason about."""

from dataclasses import replace

import numpy as np
import pytest
from slam_rooms import circled_room

from moteslam.errors import ConfigError, InputError
from moteslam.robot.recording import LidarStream
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.run import SlamSession, run_slam
from moteslam.slam.settings import load_preset, resolve_config
from moteslam.slam.tsdf.particles import Particles

pytestmark = pytest.mark.usefixtures("taichi")


def test_the_filter_finds_its_way_where_dead_reckoning_drifts():
    recording, true = circled_room()
    estimate = run_slam(recording, load_preset("paper"), seed=3)
    error = np.hypot(*(estimate.trajectory.poses - true)[:, :2].T)
    drift = np.hypot(*(estimate.dead_reckoning.poses - true)[:, :2].T)
    assert error.max() < 0.12
    assert drift.max() > 0.15
    assert np.hypot(*(estimate.trajectory_final.poses - true)[:, :2].T).max() < 0.12


def test_the_preset_defaults_online_pose_is_the_mean_of_the_best_particles_mode():
    recording, _ = circled_room(scans=40)
    session = SlamSession(recording, resolve_config("default", ["particles=20"]), seed=0)
    apart = 0.0
    for update in session:
        if update.updated and update.index:
            mean = np.average(np.unwrap(update.poses, axis=0), axis=0, weights=update.weights)
            np.testing.assert_allclose(np.cos(update.pose[2] - mean[2]), 1.0, atol=1e-6)
            np.testing.assert_allclose(update.pose[:2], mean[:2], atol=1e-9)
            apart = max(apart, np.ptp(update.poses[:, 0]))
    assert apart > 1e-3
    particles = Particles(3, TsdfConfig())
    particles.poses = np.array([(1.0, 2.0, 3.1), (1.2, 2.0, -3.1), (9.0, 2.0, 3.1)])
    x, y, turn = particles.mode_mean(0.5, 0.2)
    np.testing.assert_allclose((np.hypot(x, y), turn), (0.1, np.pi - 3.1), atol=1e-9)  # the third is elsewhere


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    recording, _ = circled_room(scans=40)
    config = resolve_config("paper", ["particles=20"])
    a, b, c = (run_slam(recording, config, seed=seed) for seed in (0, 0, 1))
    assert a.trajectory.poses.tobytes() == b.trajectory.poses.tobytes()
    assert a.map.values.tobytes() == b.map.values.tobytes()
    assert a.trajectory.poses.tobytes() != c.trajectory.poses.tobytes()


def test_scans_that_see_nothing_leave_the_robot_to_its_odometry():
    recording, _ = circled_room(scans=30)
    lidar = recording.lidar
    blind = LidarStream(
        lidar.stamps, np.full_like(lidar.ranges, np.inf), lidar.angle_min, lidar.angle_increment, 0.1, 30.0,
        odometry=lidar.odometry,
    )  # fmt: skip
    estimate = run_slam(recording.replace(lidar=blind), resolve_config("paper", ["particles=30"]))
    assert np.abs(estimate.trajectory.poses - estimate.dead_reckoning.poses).max() < 0.5
    assert np.isfinite(estimate.trajectory.poses).all()


def test_particles_spread_by_a_share_of_the_odometrys_error():
    recording, _ = circled_room(scans=40)
    lidar = recording.lidar
    assert lidar is not None
    blind = recording.replace(lidar=replace(lidar, ranges=np.full_like(lidar.ranges, np.inf)))

    def spread(*settings: str) -> float:
        still = ("proposal.rotation=0", "proposal.rotation_from_rotation=0")
        *_, last = SlamSession(blind, resolve_config("default", [*still, *settings]), seed=1)
        return float(np.linalg.norm(last.poses[:, :2].std(axis=0)))

    full = spread("proposal.sampled_share=1")
    assert spread("proposal.sampled_share=0.25") == pytest.approx(full / 4, rel=0.2)


def test_an_estimate_before_any_scan_and_a_seed_out_of_bounds_are_refused():
    recording, _ = circled_room(scans=5)
    with pytest.raises(ConfigError, match="no scan was taken in yet"):
        SlamSession(recording).estimate()
    with pytest.raises(ConfigError, match="seed"):
        SlamSession(recording, seed=-1)
    with pytest.raises(InputError, match="no lidar scans"):
        SlamSession(recording.replace(lidar=None))
