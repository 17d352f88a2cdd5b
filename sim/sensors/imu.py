"""Gyro and accelerometer at 100 Hz."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from moteslam.robot.recording import ImuStream
from moteslam.robot.section import NotNegative, Number, Section
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.vehicle import GRAVITY
from moteslam.sim.sensors.clock import ClockNoise, readings

IMU_RATE = 100.0
"""Readings a second [Hz]."""


class ImuNoise(Section):
    """The gyro and accelerometer of the UCSD robot, measured while it stood still and while it drove.

    Attributes:
        gyro_noise: standard deviation of an angular velocity at rest [rad/s] (measured 0.0037 to 0.0041).
        gyro_correlation: of that noise with itself one and two readings later (measured 0.91 and 0.69: the device
            filters its readings); a heading integrates this to about 0.05 degrees a root second.
        gyro_bias: size of the yaw rate's bias [rad/s] (measured 1.0 to 1.3 degrees a minute), either sign.
        gyro_bias_spread: its standard deviation from one recording to another, relative.
        gyro_bias_walk: random walk of the bias [rad/s per root second].
        gyro_scale_error: of the angular velocities, relative, drawn once a recording (usual for such a gyro; without
            a reference it cannot be measured in the recordings).
        accelerometer_noise: standard deviation at rest [g] (measured 0.0002 to 0.0013).
        accelerometer_bias: standard deviation of each axis, drawn once a recording [g] (measured 0.004 to 0.016).
        vibration: standard deviation of the horizontal accelerations at 1 m/s [g] (measured 0.024 to 0.028).
        tilting: standard deviation of the roll and pitch rates at 1 m/s [rad/s] (measured 0.03).
        clock: of the readings (measured: 10 ms, standard deviation 1.9 to 2.2 ms, 0.005 to 37 ms).
    """

    gyro_noise: NotNegative = 0.004
    gyro_correlation: tuple[Number, Number] = (0.905, 0.69)
    gyro_bias: NotNegative = float(np.radians(1.15) / 60)
    gyro_bias_spread: NotNegative = 0.1
    gyro_bias_walk: NotNegative = 5e-6
    gyro_scale_error: NotNegative = 0.005
    accelerometer_noise: NotNegative = 0.0007
    accelerometer_bias: NotNegative = 0.01
    vibration: NotNegative = 0.025
    tilting: NotNegative = 0.03
    clock: ClockNoise = ClockNoise(jitter=0.0009, late=0.012, late_delay=0.025, burst_interval=5e-6, rate_error=2e-4)

    @model_validator(mode="after")
    def _is_a_correlation(self) -> ImuNoise:
        one, two = self.gyro_correlation
        if not (-1 < one < 1 and 2 * one**2 - 1 < two < 1):
            raise ValueError(
                f"gyro_correlation of {one:g} and {two:g}, expected two numbers between -1 and 1 that some noise has: "
                "the second above 2 first^2 - 1"
            )
        return self


def simulate_imu(
    drive: Drive, noise: ImuNoise, scale: float, span: tuple[float, float], rng: np.random.Generator
) -> ImuStream:
    """Angular velocities, and accelerations in g with gravity on z.

    The IMU sits at the robot's centre. Each reading is the mean over the interval before it, as the device's own
    filter gives; the robot drives on a flat floor and shakes with its speed.

    Args:
        drive: what the robot truly did.
        noise: of the readings and their clock.
        scale: multiplies the gyro's noise, bias and scale error.
        span: of the first and last reading [s].
        rng: drawn from the same number of times for the same readings.
    """
    times, stamps = readings(IMU_RATE, *span, noise.clock, rng)
    count = len(times)
    heading = _mean_rate(drive.stamps, drive.poses[:, 2], times)
    velocity = np.stack([_mean_rate(drive.stamps, drive.velocities[:, axis], times) for axis in (0, 1)], axis=-1)
    theta = np.interp(times, drive.stamps, drive.poses[:, 2])
    speed = np.interp(times, drive.stamps, np.hypot(*drive.velocities[:, :2].T))
    cos, sin = np.cos(theta), np.sin(theta)
    forward = (cos * velocity[:, 0] + sin * velocity[:, 1]) / GRAVITY
    left = (cos * velocity[:, 1] - sin * velocity[:, 0]) / GRAVITY

    angular = scale * (noise.gyro_noise * _coloured(count, noise.gyro_correlation, rng) + _bias(count, noise, rng))
    shake = rng.standard_normal((count, 5)) * speed[:, None]
    angular[:, :2] += noise.tilting * shake[:, :2]
    acceleration = noise.accelerometer_noise * rng.standard_normal((count, 3))
    acceleration += noise.accelerometer_bias * rng.standard_normal(3)
    acceleration += noise.vibration * np.array((1.0, 1.0, 0.1)) * shake[:, 2:]
    acceleration += np.stack((forward, left, np.ones(count)), axis=-1)
    angular[:, 2] += heading * (1 + scale * noise.gyro_scale_error * rng.standard_normal())
    return ImuStream(stamps=stamps, angular_velocity=angular, linear_acceleration_g=acceleration)


def _mean_rate(
    stamps: NDArray[np.float64], values: NDArray[np.float64], times: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The mean rate of change over the interval before each time; these sum to the true change."""
    now, before = (np.interp(at, stamps, values) for at in (times, times - 1 / IMU_RATE))
    return np.asarray((now - before) * IMU_RATE, np.float64)


def _bias(count: int, noise: ImuNoise, rng: np.random.Generator) -> NDArray[np.float64]:
    """The biases [count, 3] [rad/s]: yaw as measured; roll and pitch, which nothing integrates, five times that."""
    size = noise.gyro_bias * (1 + noise.gyro_bias_spread * rng.standard_normal(3)) * np.array((5.0, 5.0, 1.0))
    sign = np.where(rng.random(3) < 0.5, -1.0, 1.0)
    walk = noise.gyro_bias_walk / np.sqrt(IMU_RATE) * rng.standard_normal((count, 3))
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
