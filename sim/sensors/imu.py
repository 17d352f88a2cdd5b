"""Gyro and accelerometer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.noise import ImuNoise
from moteslam.robot.platform import ImuSpec
from moteslam.robot.recording import ImuStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.vehicle import GRAVITY
from moteslam.sim.sensors.clock import readings


def simulate_imu(
    drive: Drive, spec: ImuSpec, noise: ImuNoise, scale: float, span: tuple[float, float], rng: np.random.Generator
) -> ImuStream:
    """Angular velocities, and accelerations in g with gravity on z.

    The IMU sits at the robot's centre. Each reading is the mean over the interval before it, as the device's own
    filter gives; the robot drives on a flat floor and shakes with its speed.

    Args:
        scale: multiplies the gyro's noise, bias and scale error.
        span: of the first and last reading [s].
        rng: drawn from the same number of times for the same readings.
    """
    times, stamps = readings(spec.rate, *span, noise.clock, rng)
    count = len(times)
    heading = _mean_rate(drive.stamps, drive.poses[:, 2], times, spec.rate)
    velocity = np.stack(
        [_mean_rate(drive.stamps, drive.velocities[:, axis], times, spec.rate) for axis in (0, 1)], axis=-1
    )
    theta = np.interp(times, drive.stamps, drive.poses[:, 2])
    speed = np.interp(times, drive.stamps, np.hypot(*drive.velocities[:, :2].T))
    cos, sin = np.cos(theta), np.sin(theta)
    forward = (cos * velocity[:, 0] + sin * velocity[:, 1]) / GRAVITY
    left = (cos * velocity[:, 1] - sin * velocity[:, 0]) / GRAVITY

    shimmer = noise.gyro_noise * _coloured(count, noise.gyro_correlation, rng)
    angular = scale * (shimmer + _bias(count, spec.rate, noise, rng))
    shake = rng.standard_normal((count, 5)) * speed[:, None]
    angular[:, :2] += noise.tilting * shake[:, :2]
    acceleration = noise.accelerometer_noise * rng.standard_normal((count, 3))
    acceleration += noise.accelerometer_bias * rng.standard_normal(3)
    acceleration += noise.vibration * np.array((1.0, 1.0, 0.1)) * shake[:, 2:]
    acceleration += np.stack((forward, left, np.ones(count)), axis=-1)
    angular[:, 2] += heading * (1 + scale * noise.gyro_scale_error * rng.standard_normal())
    return ImuStream(stamps=stamps, angular_velocity=angular, linear_acceleration_g=acceleration)


def _mean_rate(
    stamps: NDArray[np.float64], values: NDArray[np.float64], times: NDArray[np.float64], rate: float
) -> NDArray[np.float64]:
    """The mean rate of change over the interval before each time; these sum to the true change."""
    now, before = (np.interp(at, stamps, values) for at in (times, times - 1 / rate))
    return np.asarray((now - before) * rate, np.float64)


def _bias(count: int, rate: float, noise: ImuNoise, rng: np.random.Generator) -> NDArray[np.float64]:
    """The biases [count, 3] [rad/s]: yaw as measured; roll and pitch, which nothing integrates, five times that."""
    size = noise.gyro_bias * (1 + noise.gyro_bias_spread * rng.standard_normal(3)) * np.array((5.0, 5.0, 1.0))
    sign = np.where(rng.random(3) < 0.5, -1.0, 1.0)
    walk = noise.gyro_bias_walk / np.sqrt(rate) * rng.standard_normal((count, 3))
    return np.asarray(sign * size + np.cumsum(walk, axis=0), np.float64)


def _coloured(count: int, correlation: tuple[float, float], rng: np.random.Generator) -> NDArray[np.float64]:
    """Unit-variance noise [count, 3] with these autocorrelations one and two readings later (Yule-Walker)."""
    from scipy.signal import lfilter

    one, two = correlation
    first = one * (1 - two) / (1 - one**2)
    second = (two - one**2) / (1 - one**2)
    innovation = np.sqrt(max(1 - first * one - second * two, 0.0))
    run_in = 200  # the filter starts from rest
    white = innovation * rng.standard_normal((count + run_in, 3))
    return np.asarray(lfilter([1.0], [1.0, -first, -second], white, axis=0))[run_in:]
