"""Driving blind: speeds and turn rates in a given order."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.tables import Number, Section
from moteslam.sim.robot.limits import MAX_DURATION


class Command(Section):
    """Wheels set to a speed [m/s] and turn rate [rad/s] for some time [s], whatever is ahead."""

    duration: Annotated[Number, Field(gt=0, le=MAX_DURATION)]
    speed: Annotated[Number, Field(ge=-3, le=3)] = 0.0
    turn_rate: Annotated[Number, Field(ge=-3, le=3)] = 0.0


class Commands(Section):
    """Driving blind: where the robot starts (x, y [m], heading [rad]), and its commands in order."""

    start: tuple[Number, Number, Number]
    steps: Annotated[tuple[Command, ...], Field(min_length=1, max_length=10_000)]

    @property
    def start_pose(self) -> NDArray[np.float64]:
        """X [m], y [m], theta [rad]."""
        return np.asarray(self.start, np.float64)


class BlindDriver:
    """Follows commands in order, whatever happens; see `Driver`."""

    looks = False
    path = None

    def __init__(self, commands: Commands) -> None:
        self.at = 0
        self._steps = commands.steps
        self._ends = np.cumsum([step.duration for step in commands.steps])
        self._time = 0.0

    def command(self, time: float, x: float, y: float, theta: float) -> tuple[float, float] | None:
        """See `Driver`."""
        self._time = time
        i = int(np.searchsorted(self._ends, time, "right"))
        return None if i == len(self._steps) else (self._steps[i].speed, self._steps[i].turn_rate)

    @property
    def done(self) -> float:
        """See `Driver`."""
        return min(1.0, self._time / float(self._ends[-1]))
