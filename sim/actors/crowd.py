"""A crowd: people whom the seed puts anywhere free, and who stroll about."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE
from moteslam.robot.tables import Positive, Section, Whole
from moteslam.sim.actors.people import MAX_PEOPLE, Person, Speed
from moteslam.sim.world.true_map import true_map
from moteslam.sim.world.world import World

CLEARANCE = 0.45
"""From walls, where people of a crowd begin [m]."""
APART = 1.0
"""Between two places where people begin [m]."""


class Crowd(Section):
    """People whom the seed puts anywhere free, and who stroll about.

    Attributes:
        count: how many.
        speed: each one's is drawn between these [m/s].
        away: smallest distance from the robot's start at which they begin [m].
    """

    count: Annotated[Whole, Field(ge=1, le=MAX_PEOPLE)]
    speed: tuple[Speed, Speed] = (0.8, 1.4)
    away: Positive = 2.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Crowd:
        if self.speed[0] > self.speed[1]:
            raise ValueError(f"speed from {self.speed[0]:g} to {self.speed[1]:g} m/s, expected the first to be smaller")
        return self


def place_crowd(
    crowd: Crowd,
    world: World,
    start: NDArray[np.float64],
    others: Sequence[Person],
    rng: np.random.Generator,
) -> list[Person]:
    """The people of a crowd, each with the place it begins at.

    Args:
        crowd: how many and how fast.
        world: where they stroll; only places that can be reached from the robot's start are used.
        start: [2] the robot's [m].
        others: people who have places of their own.
        rng: of places, speeds and pauses.

    Raises:
        ConfigError: no room for all of them.
    """
    x0, y0, x1, y1 = world.bounds
    true = true_map(world, max(0.2, (x1 - x0) / 2000, (y1 - y0) / 2000), seen_from=start)
    places = rng.permutation(true.centres(np.argwhere(true.values == FREE)))
    taken = [*(person.waypoints[0] for person in others)]
    found: list[Person] = []
    for begin in range(0, len(places), 500):
        some = places[begin : begin + 500]
        for place in some[world.is_free(some, CLEARANCE)]:
            near = [math.dist(place, other) < APART for other in taken]
            if len(found) < crowd.count and math.dist(place, start) >= crowd.away and not any(near):
                found.append(_stroller(place, crowd, rng))
                taken.append((float(place[0]), float(place[1])))
        if len(found) == crowd.count:
            return found
    raise ConfigError(
        f"room for {len(found)} of {crowd.count} people, expected fewer, or more free space", field="crowd.count"
    )


def _stroller(place: NDArray[np.float64], crowd: Crowd, rng: np.random.Generator) -> Person:
    x, y = place.tolist()
    return Person(waypoints=((x, y),), speed=float(rng.uniform(*crowd.speed)), pause=float(rng.uniform(0.0, 3.0)))
