"""When a sensor takes its readings, and what stamps the host gives them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.noise import ClockNoise


def readings(
    rate: float, start: float, end: float, noise: ClockNoise, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The times of a device's readings and their stamps.

    The device ticks steadily, at a rate of its own; the host stamps late (see `ClockNoise`), and its stamps never
    decrease.

    Args:
        rate: nominal readings a second [Hz].
        start, end: of the device's first and last reading [s].
        noise: of its clock.
        rng: drawn from.

    Returns:
        true times [n] and stamps [n] [s].
    """
    period = (1 + noise.rate_error * rng.standard_normal()) / rate
    times = start + period * np.arange(max(1, int((end - start) / period) + 1))
    delay = noise.jitter * np.abs(rng.standard_normal(len(times)))
    held = rng.random(len(times)) < noise.late
    delay += held * rng.uniform(0, noise.late_delay, len(times))
    # s[i] = max(t[i] + delay[i], s[i-1] + gap): a running maximum once the gaps are taken off
    gaps = noise.burst_interval * np.arange(len(times))
    stamps = np.maximum.accumulate(times + delay - gaps) + gaps
    return np.asarray(times, np.float64), np.asarray(stamps, np.float64)
