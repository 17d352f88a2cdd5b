"""What moves in a world: people who walk, and doors that open and shut, as they stand in a scenario's file."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from moteslam.robot.section import Number, Positive, Section, Truth, Whole
from moteslam.sim.layout_types import Point
from moteslam.sim.materials import PLAIN

MAX_PEOPLE = 60
MAX_DOORS = 60
"""So many at most: each is looked at by every beam."""

Speed = Annotated[Number, Field(gt=0, le=3)]
Time = Annotated[Number, Field(ge=0, le=1800)]


class Person(Section):
    """Somebody who walks from place to place, there and back again, round the robot and others.

    Attributes:
        waypoints: where they walk [m], the first is where they start; a single one: they stroll about from there, the
            seed says where.
        speed: of their walk [m/s] (1.34 is the usual one, Helbing and Molnar 1995).
        pause: how long they stand at each place [s].
        start: how long they stand at the first [s].
        radius: of the body [m].
        legs: whether the lidar sees two legs that stride, or one disc.
        leg: radius of a leg [m].
    """

    waypoints: Annotated[tuple[Point, ...], Field(min_length=1, max_length=1000)]
    speed: Speed = 1.2
    pause: Time = 0.5
    start: Time = 0.0
    radius: Annotated[Number, Field(ge=0.1, le=0.5)] = 0.22
    legs: Truth = True
    leg: Annotated[Number, Field(ge=0.03, le=0.2)] = 0.07


class Crowd(Section):
    """People whom the seed puts anywhere free, and who stroll about.

    Attributes:
        count: how many.
        speed: each one's is drawn between these [m/s].
        away: how far from where the robot starts they begin, at least [m].
    """

    count: Annotated[Whole, Field(ge=1, le=MAX_PEOPLE)]
    speed: tuple[Speed, Speed] = (0.8, 1.4)
    away: Positive = 2.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Crowd:
        if self.speed[0] > self.speed[1]:
            raise ValueError(f"speed from {self.speed[0]:g} to {self.speed[1]:g} m/s, expected the first to be smaller")
        return self


class Door(Section):
    """A door's leaf that opens and shuts, by the clock or at random.

    Attributes:
        hinge, end: the two ends of the leaf when it is shut [m].
        kind: ``swing``: turns about its hinge; ``slide``: moves along itself past the hinge.
        opening: how far it swings [rad], counterclockwise positive.
        shut_for, open_for: for how long, in turns, beginning shut [s].
        random: whether these are means, with durations drawn by the seed (exponential), or the durations themselves.
        automatic: whether it opens for whoever comes within ``sensor`` of its middle.
        sensor: [m]
        takes: to open or shut [s]. It does not shut on anyone.
        material: of the leaf.
    """

    hinge: Point
    end: Point
    kind: Literal["swing", "slide"] = "swing"
    opening: Annotated[Number, Field(ge=-math.pi, le=math.pi)] = math.pi / 2
    shut_for: Annotated[Number, Field(gt=0, le=3600)] = 10.0
    open_for: Annotated[Number, Field(gt=0, le=3600)] = 10.0
    random: Truth = False
    automatic: Truth = True
    sensor: Annotated[Number, Field(gt=0, le=10)] = 2.0
    takes: Annotated[Number, Field(ge=0.2, le=60)] = 1.5
    material: str = PLAIN

    @model_validator(mode="after")
    def _has_a_leaf_that_moves(self) -> Door:
        if math.dist(self.hinge, self.end) < 0.05:
            raise ValueError("a leaf under 0.05 m wide, expected hinge and end apart")
        if self.kind == "slide" and self.opening != math.pi / 2:  # the default is written with every door
            raise ValueError('an opening of a door that slides, expected kind = "swing" or no opening')
        return self


class Slippery(Section):
    """A patch of floor where wheels grip less: the south-west corner, the size [m], and the grip there."""

    corner: Point
    size: tuple[Positive, Positive]
    grip: Annotated[Number, Field(gt=0, le=2)] = 0.1


class Outage(Section):
    """A sensor that dies and comes back: which, from when after the drive's start, and for how long [s].

    What the wheels turn meanwhile is lost with the readings: a dead counter counts nothing.
    """

    sensor: Literal["lidar", "encoders", "imu"]
    start: Time
    duration: Annotated[Number, Field(gt=0, le=1800)]
