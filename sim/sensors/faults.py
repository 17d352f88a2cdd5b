"""What happens to readings once they are taken: lost messages, sensors that die for a while, clocks that are off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.noise import ClockNoise
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream
from moteslam.robot.tables import Number, Section
from moteslam.sim.robot.mishaps import Carried

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
    """The readings that arrive, with the stamps that they get.

    A reading of the wheel counters that is lost takes its counts with it: the counters have been reset.

    Args:
        stream: as the sensor took it, stamps from the drive's start [s].
        clock: its faults.
        outages: of this sensor, and when it is off while the robot is carried.
        rng: of which messages are lost; drawn from only if some are.
    """
    kept = np.ones(len(stream), bool)
    if clock.lost > 0:
        kept &= rng.random(len(stream)) >= clock.lost
    for outage in outages:
        kept &= (stream.stamps < outage.start) | (stream.stamps >= outage.start + outage.duration)
    stream = readings_of(stream, kept)
    if clock.offset or clock.drift:
        stream = replace(stream, stamps=stream.stamps + clock.offset + clock.drift * stream.stamps)
    return stream


def readings_of(stream: Stream, kept: NDArray[np.bool_]) -> Stream:
    """Those readings of a stream that are kept [n], the stream itself where all are."""
    if kept.all():
        return stream
    arrays: dict[str, Any] = {
        field.name: value[kept]
        for field in fields(stream)
        if isinstance(value := getattr(stream, field.name), np.ndarray)
    }
    return replace(stream, **arrays)
