"""Four wheel counters that reset when read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.noise import EncoderNoise
from moteslam.robot.platform import Platform
from moteslam.robot.recording import EncoderStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.clock import readings

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


def _bursts(times: NDArray[np.float64], noise: EncoderNoise, rng: np.random.Generator) -> NDArray[np.float64]:
    """1 where a wheel spins in a burst, else 0: [n, 4]."""
    count = rng.poisson(noise.bursts * (times[-1] - times[0]) / 60)
    start = rng.uniform(times[0], times[-1], count)
    end = start + rng.exponential(noise.burst_time, count)
    right = rng.random(count) < 0.5
    spins = np.zeros((len(times), 4))
    for begin, until, side in zip(start, end, right, strict=True):
        spins[np.ix_((times >= begin) & (times < until), np.flatnonzero(side == _RIGHT))] = 1.0
    return spins


def _with_errors(
    steps: NDArray[np.float64], rate: float, noise: EncoderNoise, scale: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """The travel between readings [n, 4] [m] as the counters see it."""
    common = noise.scale_error * rng.standard_normal()
    wheel = noise.radius_error * rng.standard_normal(4)
    track = noise.track_error * rng.standard_normal()
    # momentary slip: first-order noise, the same for both wheels of a side
    keep = np.exp(-1 / (rate * noise.slip_time))
    white = rng.standard_normal((len(steps), 2))
    white[1:] *= np.sqrt(1 - keep**2)
    slip = noise.slip * _first_order(white, keep)
    right, left = steps[:, _RIGHT].mean(1), steps[:, ~_RIGHT].mean(1)
    turning = np.where(_RIGHT, 0.5, -0.5) * (right - left)[:, None]
    factor = 1 + scale * (common + wheel + slip[:, np.where(_RIGHT, 0, 1)])
    return np.asarray((steps + scale * track * turning) * factor, np.float64)


def _first_order(white: NDArray[np.float64], keep: float) -> NDArray[np.float64]:
    """The recursion y[i] = keep y[i-1] + white[i] along the first axis."""
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=0))
