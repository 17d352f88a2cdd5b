"""When a sensor takes its readings, what stamps the host gives them, and which of them arrive."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import Field

from moteslam.robot.noise import ClockNoise
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream
from moteslam.robot.se2 import Array
from moteslam.robot.values import Number, Section
from moteslam.sim.robot.mishaps import Carried


def readings(rate: float, start: float, end: float, noise: ClockNoise, rng: np.random.Generator) -> tuple[Array, Array]:
    """The true times [n] of a device's readings and their stamps [n] [s], from the first to the last of its span.

    The device ticks steadily, at a ``rate`` [Hz] of its own; the host stamps late (see `ClockNoise`), and its stamps
    never decrease.
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


def arrived(times: Array, stamps: Array, until: float) -> int:
    """How many readings that are complete at times [n] and stamped [n] have arrived by a time [s]."""
    taken = np.searchsorted(times, until, side="right")
    return int(min(taken, np.searchsorted(stamps, until, side="right")))


EPOCH = 1_300_000_000.0  # Stamp of the drive's first moment [s since 1970]: stamps are as coarse as a real robot's

Stream = TypeVar("Stream", LidarStream, EncoderStream, ImuStream, OdometryStream)


class Outage(Section):
    """A sensor that dies and comes back: which, when after the drive's start [s], and for how long [s].

    What the wheels turn meanwhile is lost with the readings: a dead counter counts nothing.
    """

    sensor: Literal["lidar", "encoders", "imu"]
    start: Annotated[Number, Field(ge=0, le=1800)]
    duration: Annotated[Number, Field(gt=0, le=1800)]


def with_faults(
    stream: Stream, clock: ClockNoise, outages: Sequence[Outage | Carried], rng: np.random.Generator
) -> Stream:
    """The readings of a stream (stamps from the drive's start [s]) that arrive, with the stamps that they get.

    A lost reading of the wheel counters takes its counts with it: they have been reset. ``rng`` is drawn from only
    where messages are lost.
    """
    kept = np.ones(len(stream), bool)
    if clock.lost > 0:
        kept &= rng.random(len(stream)) >= clock.lost
    for outage in outages:
        kept &= (stream.stamps < outage.start) | (stream.stamps >= outage.start + outage.duration)
    stream = stream if kept.all() else stream.take(kept)
    if clock.offset or clock.drift:
        stream = replace(stream, stamps=stream.stamps + clock.offset + clock.drift * stream.stamps)
    return stream
