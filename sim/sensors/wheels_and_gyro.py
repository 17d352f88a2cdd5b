"""Wheel counters, which reset when read, gyro and accelerometer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.noise import EncoderNoise, ImuNoise
from moteslam.robot.platform import ImuSpec, Platform
from moteslam.robot.recording import EncoderStream, ImuStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.vehicle import GRAVITY
from moteslam.sim.sensors.clock import readings

Array = NDArray[np.float64]

_RIGHT = np.array((True, False, True, False))
"""Which of FR, FL, RR, RL are on the right."""


def simulate_encoders(
    drive: Drive,
    platform: Platform,
    noise: EncoderNoise,
    scale: float,
    span: tuple[float, float],
    rng: np.random.Generator,
    *,
    effects: np.random.Generator,
) -> EncoderStream:
    """The counts int64 [n, 4] of the FR, FL, RR, RL wheel, and their stamps from 0 [s].

    The counters see the rims' travel of the drive, which includes the slip in turns; errors of the wheels' radii and
    the track come on top, and momentary slip that differs from side to side.

    Args:
        scale: multiplies slip, scale, radius and track errors.
        span: of the first and last reading [s].
        rng: drawn from the same number of times for the same readings.
        effects: of slip bursts and missed ticks, drawn from only where there are any.
    """
    wheels, spec = platform.wheels, platform.encoders
    assert wheels is not None  # a scenario without is refused, as one without encoders
    assert spec is not None
    times, stamps = readings(spec.rate, *span, noise.clock, rng)
    travel = np.stack([np.interp(times, drive.stamps, wheel) for wheel in drive.wheel_travel.T], axis=-1)
    seen = _with_errors(np.diff(travel, axis=0, prepend=travel[:1]), spec.rate, noise, scale, rng)
    seen *= 1.0 / np.asarray(noise.radius_factors)  # a larger wheel turns less over the same distance
    if noise.bursts > 0:
        seen *= 1.0 + noise.burst_slip * _bursts(times, noise, effects)
    # the counter counts whole ticks; the rest stays in the wheel, for the next reading
    ticks = np.floor(rng.random(4) + np.cumsum(seen, axis=0) / wheels.metres_per_count).astype(np.int64)
    counts = np.diff(ticks, axis=0, prepend=ticks[:1])
    if noise.missed > 0:
        counts = np.sign(counts) * (np.abs(counts) - effects.binomial(np.abs(counts), noise.missed))
    if wheels.wheel_base == 0:  # two wheels, whose counts stand for front and rear
        counts[:, 2:] = counts[:, :2]
    return EncoderStream(stamps=stamps, counts=counts.astype(np.int64))


def _bursts(times: Array, noise: EncoderNoise, rng: np.random.Generator) -> Array:
    """1 where a wheel spins in a burst, else 0: [n, 4]."""
    count = rng.poisson(noise.bursts * (times[-1] - times[0]) / 60)
    start = rng.uniform(times[0], times[-1], count)
    end = start + rng.exponential(noise.burst_time, count)
    right = rng.random(count) < 0.5
    spins = np.zeros((len(times), 4))
    for begin, until, side in zip(start, end, right, strict=True):
        spins[np.ix_((times >= begin) & (times < until), np.flatnonzero(side == _RIGHT))] = 1.0
    return spins


def _with_errors(steps: Array, rate: float, noise: EncoderNoise, scale: float, rng: np.random.Generator) -> Array:
    """The travel between readings [n, 4] [m] as the counters see it."""
    from scipy.signal import lfilter

    common = noise.scale_error * rng.standard_normal()
    wheel = noise.radius_error * rng.standard_normal(4)
    track = noise.track_error * rng.standard_normal()
    # momentary slip: first-order noise, the same for both wheels of a side
    keep = np.exp(-1 / (rate * noise.slip_time))
    white = rng.standard_normal((len(steps), 2))
    white[1:] *= np.sqrt(1 - keep**2)
    slip = noise.slip * lfilter([1.0], [1.0, -keep], white, axis=0)
    right, left = steps[:, _RIGHT].mean(1), steps[:, ~_RIGHT].mean(1)
    turning = np.where(_RIGHT, 0.5, -0.5) * (right - left)[:, None]
    factor = 1 + scale * (common + wheel + slip[:, np.where(_RIGHT, 0, 1)])
    return np.asarray((steps + scale * track * turning) * factor, np.float64)


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


def _mean_rate(stamps: Array, values: Array, times: Array, rate: float) -> Array:
    """The mean rate of change over the interval before each time; these sum to the true change."""
    now, before = (np.interp(at, stamps, values) for at in (times, times - 1 / rate))
    return np.asarray((now - before) * rate, np.float64)


def _bias(count: int, rate: float, noise: ImuNoise, rng: np.random.Generator) -> Array:
    """The biases [count, 3] [rad/s]: yaw as measured; roll and pitch, which nothing integrates, five times that."""
    size = noise.gyro_bias * (1 + noise.gyro_bias_spread * rng.standard_normal(3)) * np.array((5.0, 5.0, 1.0))
    sign = np.where(rng.random(3) < 0.5, -1.0, 1.0)
    walk = noise.gyro_bias_walk / np.sqrt(rate) * rng.standard_normal((count, 3))
    return np.asarray(sign * size + np.cumsum(walk, axis=0), np.float64)


def _coloured(count: int, correlation: tuple[float, float], rng: np.random.Generator) -> Array:
    """Unit-variance noise [count, 3] with these autocorrelations one and two readings later (Yule-Walker)."""
    from scipy.signal import lfilter

    one, two = correlation
    first = one * (1 - two) / (1 - one**2)
    second = (two - one**2) / (1 - one**2)
    innovation = np.sqrt(max(1 - first * one - second * two, 0.0))
    run_in = 200  # the filter starts from rest
    white = innovation * rng.standard_normal((count + run_in, 3))
    return np.asarray(lfilter([1.0], [1.0, -first, -second], white, axis=0))[run_in:]
