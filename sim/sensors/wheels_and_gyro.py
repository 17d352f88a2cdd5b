"""Wheel counters, which reset when read, gyro and accelerometer."""

import numpy as np

from moteslam.robot.noise import EncoderNoise, ImuNoise
from moteslam.robot.platform import ImuSpec, Platform
from moteslam.robot.recording import EncoderStream, ImuStream
from moteslam.robot.se2 import Array
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.vehicle import GRAVITY
from moteslam.sim.sensors.clock import readings

_RIGHT = np.array((True, False, True, False))  # Which of FR, FL, RR, RL are on the right


class Encoders:
    """The counters of the FR, FL, RR, RL wheel, from the first to the last reading of a ``span`` [s].

    They see the rims' travel of the drive, which includes the slip in turns; errors of the wheels' radii and the track
    come on top, times ``scale``, and momentary slip that differs from side to side. All but missed ticks is drawn
    beforehand, for the same readings as many numbers from ``rng``; ``effects`` are of slip bursts and missed ticks.
    """

    def __init__(
        self,
        platform: Platform,
        noise: EncoderNoise,
        scale: float,
        span: tuple[float, float],
        rng: np.random.Generator,
        *,
        effects: np.random.Generator,
    ) -> None:
        wheels, spec = platform.wheels, platform.encoders
        assert wheels is not None  # a scenario without is refused, as one without encoders
        assert spec is not None
        self._wheels, self._noise, self._effects = wheels, noise, effects
        # [n] when they are taken, and as the host stamps them, from 0 [s]
        self.times, self.stamps = readings(spec.rate, *span, noise.clock, rng)
        self._track, self._factor = _errors(len(self.times), spec.rate, noise, scale, rng)
        self._rest = rng.random(4)  # the counter counts whole ticks; the rest stays in the wheel, for the next reading
        self._spins = _bursts(self.times, noise, effects) if noise.bursts > 0 else None
        self._read = 0
        self._before = self._travel = np.zeros((1, 4))  # at the reading before
        self._ticks = np.zeros((1, 4), np.int64)

    def read(self, drive: Drive, until: int) -> EncoderStream:
        """The counts int64 [m, 4] of the readings from where it was read last to before another one."""
        rows, noise = slice(self._read, until), self._noise
        stamps, times = self.stamps[rows], self.times[rows]
        travel = np.stack([np.interp(times, drive.stamps, wheel) for wheel in drive.wheel_travel.T], axis=-1)
        first = not self._read and len(times)
        seen = np.diff(travel, axis=0, prepend=travel[:1] if first else self._before)
        right, left = seen[:, _RIGHT].mean(1), seen[:, ~_RIGHT].mean(1)
        turning = np.where(_RIGHT, 0.5, -0.5) * (right - left)[:, None]
        seen = (seen + self._track * turning) * self._factor[rows]
        seen *= 1.0 / np.asarray(noise.radius_factors)  # a larger wheel turns less over the same distance
        if self._spins is not None:
            seen *= 1.0 + noise.burst_slip * self._spins[rows]
        total = np.cumsum(np.concatenate((self._travel, seen)), axis=0)
        ticks = np.floor(self._rest + total[1:] / self._wheels.metres_per_count).astype(np.int64)
        counts = np.diff(ticks, axis=0, prepend=ticks[:1] if first else self._ticks).astype(np.int64)
        if len(times):
            self._before, self._travel, self._ticks, self._read = travel[-1:], total[-1:], ticks[-1:], until
        if noise.missed > 0:
            counts = np.sign(counts) * (np.abs(counts) - self._effects.binomial(np.abs(counts), noise.missed))
        if self._wheels.wheel_base == 0:  # two wheels, whose counts stand for front and rear
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


def _errors(
    count: int, rate: float, noise: EncoderNoise, scale: float, rng: np.random.Generator
) -> tuple[float, Array]:
    """How the counters see the travel between readings: the error of the track, and the factor [n, 4] of the rest."""
    from scipy.signal import lfilter

    common = noise.scale_error * rng.standard_normal()
    wheel = noise.radius_error * rng.standard_normal(4)
    track = noise.track_error * rng.standard_normal()
    # momentary slip: first-order noise, the same for both wheels of a side
    keep = np.exp(-1 / (rate * noise.slip_time))
    white = rng.standard_normal((count, 2))
    white[1:] *= np.sqrt(1 - keep**2)
    slip = noise.slip * lfilter([1.0], [1.0, -keep], white, axis=0)
    return scale * track, 1 + scale * (common + wheel + slip[:, np.where(_RIGHT, 0, 1)])


class Imu:
    """Angular velocities, and accelerations in g with gravity on z, from the first to the last reading of a ``span``
    [s].

    The IMU sits at the robot's centre. Each reading is the mean over the interval before it, as the device's own filter
    gives; the robot drives on a flat floor and shakes with its speed. All that is random is drawn beforehand, for the
    same readings as many numbers from ``rng``; ``scale`` multiplies the gyro's noise, bias and scale error.
    """

    def __init__(
        self, spec: ImuSpec, noise: ImuNoise, scale: float, span: tuple[float, float], rng: np.random.Generator
    ) -> None:
        self._rate, self._noise = spec.rate, noise
        self.times, self.stamps = readings(spec.rate, *span, noise.clock, rng)
        count = len(self.times)
        shimmer = noise.gyro_noise * _coloured(count, noise.gyro_correlation, rng)
        # roll and pitch, which nothing integrates, have five times the bias of the yaw, which is as measured
        size = noise.gyro_bias * (1 + noise.gyro_bias_spread * rng.standard_normal(3)) * np.array((5.0, 5.0, 1.0))
        sign = np.where(rng.random(3) < 0.5, -1.0, 1.0)
        walk = noise.gyro_bias_walk / np.sqrt(spec.rate) * rng.standard_normal((count, 3))
        self._angular = scale * (shimmer + (sign * size + np.cumsum(walk, axis=0)))
        self._shake = rng.standard_normal((count, 5))
        self._acceleration = noise.accelerometer_noise * rng.standard_normal((count, 3))
        self._acceleration += noise.accelerometer_bias * rng.standard_normal(3)
        self._scale = 1 + scale * noise.gyro_scale_error * rng.standard_normal()
        self._read = 0

    def read(self, drive: Drive, until: int) -> ImuStream:
        """The readings from where it was read last to before another one."""
        rows, noise = slice(self._read, until), self._noise
        self._read = until
        times = self.times[rows]
        heading = _mean_rate(drive.stamps, drive.poses[:, 2], times, self._rate)
        velocity = np.stack(
            [_mean_rate(drive.stamps, drive.velocities[:, axis], times, self._rate) for axis in (0, 1)], axis=-1
        )
        theta = np.interp(times, drive.stamps, drive.poses[:, 2])
        speed = np.interp(times, drive.stamps, np.hypot(*drive.velocities[:, :2].T))
        cos, sin = np.cos(theta), np.sin(theta)
        forward = (cos * velocity[:, 0] + sin * velocity[:, 1]) / GRAVITY
        left = (cos * velocity[:, 1] - sin * velocity[:, 0]) / GRAVITY
        angular, shake = self._angular[rows].copy(), self._shake[rows] * speed[:, None]
        angular[:, :2] += noise.tilting * shake[:, :2]
        acceleration = self._acceleration[rows] + noise.vibration * np.array((1.0, 1.0, 0.1)) * shake[:, 2:]
        acceleration += np.stack((forward, left, np.ones(len(times))), axis=-1)
        angular[:, 2] += heading * self._scale
        return ImuStream(stamps=self.stamps[rows], angular_velocity=angular, linear_acceleration_g=acceleration)


def _mean_rate(stamps: Array, values: Array, times: Array, rate: float) -> Array:
    """The mean rate of change over the interval before each time; these sum to the true change."""
    now, before = (np.interp(at, stamps, values) for at in (times, times - 1 / rate))
    return np.asarray((now - before) * rate, np.float64)


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
