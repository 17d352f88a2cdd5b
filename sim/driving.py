"""What the robot is asked to do: the limits it drives within, and a route, a wander, or plain commands."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot.platform import Wheels
from moteslam.robot.section import NotNegative, Number, Positive, Section, Truth
from moteslam.sim.layout import Point

MAX_DURATION = 1800.0
"""The longest recording [s]: 72 000 scans, 311 MB of ranges."""

Seconds = Annotated[Number, Field(ge=0, le=MAX_DURATION)]


class Limits(Section):
    """How the robot drives.

    Attributes:
        speed: at most [m/s]; turn_rate: at most [rad/s].
        acceleration: of the speed, at most [m/s^2]; turn_acceleration: of the turn rate [rad/s^2].
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


class Route(Section):
    """Waypoints that are driven past in order, in straight legs with rounded corners.

    Attributes:
        waypoints: [m]; the robot starts on the first, heading for the second.
        closed: whether the last leads back to the first.
        laps: how many times round a closed route, parts of a lap included.
    """

    waypoints: Annotated[tuple[Point, ...], Field(min_length=2, max_length=10_000)]
    closed: Truth = False
    laps: Annotated[Number, Field(gt=0, le=100)] = 1.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Route:
        if self.laps != 1.0 and not self.closed:
            raise ValueError("laps of an open route, expected closed = true or no laps")
        if (np.hypot(*np.diff(self.corners, axis=0).T) == 0).any():
            raise ValueError("two successive waypoints are the same, expected them apart")
        return self

    @property
    def corners(self) -> NDArray[np.float64]:
        """The corners [k, 2] of one lap, the first repeated at the end if it is closed."""
        points = (*self.waypoints, self.waypoints[0]) if self.closed else self.waypoints
        return np.asarray(points, np.float64)

    def path(self) -> NDArray[np.float64]:
        """The corners [k, 2] of all the laps, the last lap cut where it ends."""
        lap = self.corners
        if not self.closed:
            return lap
        whole = int(self.laps)
        corners = np.concatenate([lap[:-1]] * whole + [lap])
        length = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
        end = self.laps * length[len(lap) - 1]
        kept = length < end - 1e-9
        last = [np.interp(end, length, corners[:, axis]) for axis in (0, 1)]
        return np.concatenate((corners[kept], [last]))


class Wander(Section):
    """A route of straight legs between places chosen at random (by the seed) in view of each other.

    Attributes:
        start: where the robot starts [m].
        distance: how far to drive, at least [m].
        leg: how long a leg is at least and at most [m].
        clearance: how far from the walls to stay [m].
    """

    start: Point
    distance: Annotated[Number, Field(gt=0, le=5000)]
    leg: tuple[Positive, Positive] = (2.0, 8.0)
    clearance: Positive = 0.6

    @model_validator(mode="after")
    def _makes_sense(self) -> Wander:
        if self.leg[0] >= self.leg[1]:
            raise ValueError(f"leg from {self.leg[0]:g} to {self.leg[1]:g} m, expected the first to be smaller")
        return self


class Command(Section):
    """Wheels set to a speed [m/s] and turn rate [rad/s] for some time [s], whatever comes in the way."""

    duration: Annotated[Number, Field(gt=0, le=MAX_DURATION)]
    speed: Annotated[Number, Field(ge=-3, le=3)] = 0.0
    turn_rate: Annotated[Number, Field(ge=-3, le=3)] = 0.0


class Commands(Section):
    """Driving blind: where the robot starts (x, y [m], heading [rad]), and its commands in order."""

    start: tuple[Number, Number, Number]
    steps: Annotated[tuple[Command, ...], Field(min_length=1, max_length=10_000)]


class Body(Section):
    """The robot as a mass on four wheels.

    Attributes:
        mass: [kg].
        wheel_mass: what the wheel and motor weigh on at the rim [kg].
        grip: friction of a wheel on the floor, 1 = its share of the weight.
        stiffness: contact force for a slip of 1 m/s [N s/m], before the grip gives way.
        wheel_force: the most a motor pushes at the rim [N].
        wall_friction: of the body against what it runs into.
    """

    mass: Annotated[Number, Field(gt=0.1, le=1000)] = 20.0
    wheel_mass: Annotated[Number, Field(gt=0.1, le=100)] = 1.5
    grip: Annotated[Number, Field(gt=0, le=2)] = 0.8
    stiffness: Annotated[Number, Field(gt=0, le=200)] = 100.0
    wheel_force: Annotated[Number, Field(gt=0, le=1000)] = 60.0
    wall_friction: NotNegative = 0.4


def sideways_ratio(wheels: Wheels) -> float:
    """How much stiffer the wheels' contact is sideways than lengthwise, from the effective track (see `drive.py`)."""
    return (wheels.effective_track - wheels.track) * wheels.track / wheels.wheel_base**2
