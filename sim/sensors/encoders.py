"""Four wheel counters that reset when read."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream
from moteslam.robot.section import NotNegative, Number, Positive, Section, Share
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.clock import ClockNoise, readings

ENCODER_RATE = 40.0
"""Readings of the wheel counters a second [Hz]."""

Factor = Annotated[Number, Field(ge=0.5, le=2)]

_RIGHT = np.array((True, False, True, False))
"""Which of FR, FL, RR, RL are on the right."""


class EncoderNoise(Section):
    """Wheels that are not what the data sheet says, on a floor that is not even.

    Attributes:
        scale_error: of all the wheels' radius, relative, drawn once a recording.
        radius_error: of each wheel's radius, relative, drawn once a recording.
        track_error: of the effective track, relative, drawn once a recording.
        slip: standard deviation of each side's momentary slip, relative to its travel.
        slip_time: correlation time of the slip [s].
        radius_factors: what the true radii of the FR, FL, RR, RL wheel are times what they should be.
        missed: share of the ticks that a counter misses.
        bursts: slip bursts a minute, of one side at a time.
        burst_slip: how much more the wheels of that side turn in a burst than they travel, relative.
        burst_time: how long a burst lasts, on average (exponential) [s].
        clock: of the readings (measured: intervals of 25 ms, standard deviation 3.7 to 6.1 ms, 3 to 68 ms).
    """

    scale_error: NotNegative = 0.004
    radius_error: NotNegative = 0.0005
    track_error: NotNegative = 0.01
    slip: NotNegative = 0.02
    slip_time: Positive = 0.5
    radius_factors: tuple[Factor, Factor, Factor, Factor] = (1.0, 1.0, 1.0, 1.0)
    missed: Share = 0.0
    bursts: Annotated[Number, Field(ge=0, le=600)] = 0.0
    burst_slip: Annotated[Number, Field(ge=-1, le=10)] = 0.5
    burst_time: Positive = 0.4
    clock: ClockNoise = ClockNoise(jitter=0.002, late=0.02, late_delay=0.04, burst_interval=0.0032, rate_error=2e-4)


def simulate_encoders(
    drive: Drive,
    wheels: Wheels,
    noise: EncoderNoise,
    scale: float,
    span: tuple[float, float],
    rng: np.random.Generator,
    *,
    effects: np.random.Generator | None = None,
) -> EncoderStream:
    """The counts of the four wheels.

    The counters see the rims' travel of the drive, which includes the slip in turns; errors of the wheels' radii and
    the track come on top, and momentary slip that differs from side to side.

    Args:
        drive: what the wheels truly did.
        wheels: the robot's.
        noise: of the counters and their clock.
        scale: multiplies slip, scale, radius and track errors.
        span: of the first and last reading [s].
        rng: random generator of the rest, drawn from the same number of times for the same readings.
        effects: random generator of slip bursts and missed ticks, drawn from only where there are any; of seed 0 by
            default.

    Returns:
        counts int64 [n, 4], order FR, FL, RR, RL; stamps [n] from 0 [s].
    """
    times, stamps = readings(ENCODER_RATE, *span, noise.clock, rng)
    travel = np.stack([np.interp(times, drive.stamps, wheel) for wheel in drive.wheel_travel.T], axis=-1)
    seen = _with_errors(np.diff(travel, axis=0, prepend=travel[:1]), noise, scale, rng)
    effects = np.random.default_rng(0) if effects is None else effects
    seen *= 1.0 / np.asarray(noise.radius_factors)  # a larger wheel turns less over the same distance
    if noise.bursts > 0:
        seen *= 1.0 + noise.burst_slip * _bursts(times, noise, effects)
    # the counter counts whole ticks; the rest stays in the wheel, for the next reading
    ticks = np.floor(rng.random(4) + np.cumsum(seen, axis=0) / wheels.metres_per_count).astype(np.int64)
    counts = np.diff(ticks, axis=0, prepend=ticks[:1])
    if noise.missed > 0:
        counts = np.sign(counts) * (np.abs(counts) - effects.binomial(np.abs(counts), noise.missed))
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
    steps: NDArray[np.float64], noise: EncoderNoise, scale: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """The travel between readings [n, 4] [m] as the counters see it."""
    common = noise.scale_error * rng.standard_normal()
    wheel = noise.radius_error * rng.standard_normal(4)
    track = noise.track_error * rng.standard_normal()
    # momentary slip: first-order noise, the same for both wheels of a side
    keep = np.exp(-1 / (ENCODER_RATE * noise.slip_time))
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
