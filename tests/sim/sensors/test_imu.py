"""What the gyro adds to the truth, one error at a time: each as large as it is configured."""

from __future__ import annotations

import numpy as np
import pytest
from sim_drives import steady
from ucsd_robot import IMU

from moteslam.robot.noise import ImuNoise
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.imu import simulate_imu


def angular_velocity(drive: Drive, seed: int = 0, **errors: float) -> np.ndarray:
    """The readings [n, 3] [rad/s] with these errors alone."""
    noise = ImuNoise(**errors)
    span = (0.01, float(drive.stamps[-1]))
    return simulate_imu(drive, IMU, noise, 1.0, span, np.random.default_rng(seed)).angular_velocity


def test_without_errors_the_gyro_reads_the_true_rate() -> None:
    np.testing.assert_allclose(angular_velocity(steady(2.0, turn_rate=0.7)), [[0.0, 0.0, 0.7]] * 200, atol=1e-9)


def test_the_scale_error_is_one_factor_a_recording() -> None:
    turning = steady(1.0, turn_rate=1.0)
    rates = np.array([angular_velocity(turning, seed, gyro_scale_error=0.02)[:, 2] for seed in range(200)])
    assert np.ptp(rates, axis=1).max() < 1e-9
    assert (rates[:, 0] - 1).std() == pytest.approx(0.02, rel=0.15)
    assert not angular_velocity(steady(1.0), gyro_scale_error=0.02).any()


def test_the_bias_walks_with_the_root_of_time() -> None:
    walk, still = 1e-4, steady(100.0)
    readings = np.array([angular_velocity(still, seed, gyro_bias_walk=walk) for seed in range(80)])
    # three axes, each with a walk of its own
    for seconds in (25, 100):
        size = np.sqrt(np.square(readings[:, 100 * seconds - 1]).mean())
        assert size == pytest.approx(walk * np.sqrt(seconds), rel=0.15)
    steps = np.diff(readings[0], axis=0)
    assert steps.std() == pytest.approx(walk * np.sqrt(0.01), rel=0.05)
