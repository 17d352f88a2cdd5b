"""The limits that a robot drives within, and intervals of its drive."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.tables import Number, Positive, Section

MAX_DURATION = 12_000.0
"""The longest recording [s], for two kilometres at 0.2 m/s; of `ucsd` 480 000 scans, 2.1 GB of ranges."""

Seconds = Annotated[Number, Field(ge=0, le=MAX_DURATION)]


class Limits(Section):
    """How the robot drives.

    Attributes:
        speed, turn_rate: at most [m/s, rad/s].
        acceleration, turn_acceleration: of these, at most [m/s^2, rad/s^2].
        lookahead: distance ahead on the route that is aimed at [m].
        wander: standard deviation of the driver's sideways inattention [m], over ``wander_distance`` [m].
        rest_start, rest_end: standing still before and after [s]: long enough to see the gyro's bias.
    """

    speed: Annotated[Number, Field(gt=0, le=3)] = 0.95
    turn_rate: Annotated[Number, Field(gt=0, le=3)] = 1.0
    acceleration: Annotated[Number, Field(gt=0, le=5)] = 0.8
    turn_acceleration: Annotated[Number, Field(gt=0, le=10)] = 2.5
    lookahead: Annotated[Number, Field(gt=0, le=5)] = 0.7
    wander: Annotated[Number, Field(ge=0, le=1)] = 0.03
    wander_distance: Positive = 2.0
    rest_start: Seconds = 6.0
    rest_end: Seconds = 4.0


Duration = Annotated[Number, Field(gt=0, le=MAX_DURATION)]


class Interval(Section):
    """A part of a drive: from ``start`` after its first moment [s], for ``duration`` [s] or to its end."""

    start: Seconds = 0.0
    duration: Duration | None = None

    @property
    def end(self) -> float:
        """When it ends [s], infinite where it lasts to the drive's end."""
        return math.inf if self.duration is None else self.start + self.duration

    def covers(self, times: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which times [...] since the drive's first moment [s] are in it, its start but not its end."""
        return np.asarray((times >= self.start) & (times < self.end))


class Spell(Interval):
    """An interval of which both must be said."""

    start: Seconds
    duration: Duration
