"""When a sensor takes its readings, and what stamps the host gives them."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.section import NotNegative, Number, Section, Share


class ClockNoise(Section):
    """How a host stamps the readings of a device that itself ticks steadily.

    On the real robot the counts do not follow the intervals between the stamps: the jitter is in the stamping. So a
    stamp is the time of the reading plus a delay; readings that were held up come out in a burst.

    Attributes:
        jitter: scale of the usual, half-normal delay [s].
        late: probability that a reading is held up.
        late_delay: longest such delay [s], uniform from 0.
        burst_interval: shortest interval between two stamps [s].
        rate_error: standard deviation of the device's rate, relative, drawn once a recording.
        offset: that all of its stamps are too late [s]; negative: too early.
        drift: by how much the offset grows [s/s].
        lost: share of its messages that never arrive.
    """

    jitter: NotNegative = 0.0
    late: Share = 0.0
    late_delay: NotNegative = 0.0
    burst_interval: NotNegative = 0.0
    rate_error: NotNegative = 0.0
    offset: Annotated[Number, Field(ge=-10, le=10)] = 0.0
    drift: Annotated[Number, Field(ge=-0.01, le=0.01)] = 0.0
    lost: Annotated[Number, Field(ge=0, lt=1)] = 0.0


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
