"""Everybody and everything that moves in a scenario beside the robot, and how the robot minds them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.sim.doors import Leaf
from moteslam.sim.movers import Movers, movers_of
from moteslam.sim.moving import Crowd, Person
from moteslam.sim.truth import FREE, true_map
from moteslam.sim.walkers import Walkers
from moteslam.sim.world import World

if TYPE_CHECKING:
    import pymunk

    from moteslam.sim.scenario import Scenario

KEEPS, SLOWS = 0.25, 0.9
"""The robot stops with this gap to who is ahead, and slows down from that on [m]."""
PATIENCE = 60.0
"""So long it waits for a way to become free [s]."""
CROWD_CLEARANCE = 0.45
"""From walls, where people of a crowd begin [m]."""


class Cast:
    """The people and doors of a scenario, in the robot's physics engine.

    Args:
        scenario: that has some.
        world: it takes place in.
        space: of the physics engine.
        rng: of schedules, strolls and the crowd.

    Raises:
        ConfigError: no room for the crowd.
    """

    def __init__(self, scenario: Scenario, world: World, space: pymunk.Space, rng: np.random.Generator) -> None:
        doors, crowd, strolls = rng.spawn(3)
        self.persons = (*scenario.people, *_crowd(scenario, world, crowd))
        self._leaves = [Leaf(door, space, scenario.duration, doors) for door in scenario.doors]
        names = list(scenario.world.palette)
        self._surfaces = [names.index(door.material) for door in scenario.doors]
        self._walkers = Walkers(self.persons, world, space, strolls)
        self._radius = scenario.radius
        self._front, self._side = scenario.platform.length / 2, scenario.platform.width / 2
        self._places: list[NDArray[np.float64]] = []
        self._ends: list[NDArray[np.float64]] = []

    def move(self, time: float, interval: float, robot: tuple[float, float]) -> None:
        """Let everyone choose what to do for the next interval [s], given where the robot is."""
        bodies = np.concatenate((self._walkers.places, np.array(robot)[None]))
        radii = np.append(self._walkers.radii, self._radius)
        for leaf in self._leaves:
            leaf.move(time, interval, bodies, radii)
        if self.persons:
            self._walkers.walk(time, interval, robot, self._radius)

    def record(self) -> None:
        """Write down where everyone is now."""
        self._places.append(self._walkers.places)
        self._ends.append(self._leaf_ends())

    def movers(self) -> Movers:
        """All that was written down."""
        return movers_of(self.persons, np.array(self._places), np.array(self._ends), self._surfaces)

    def pace(self, x: float, y: float, theta: float) -> float:
        """What share of its speed the robot's driver dares: none with somebody right ahead."""
        points = [self._walkers.places]
        radii = [self._walkers.radii]
        for line in self._leaf_ends():
            share = np.linspace(0.0, 1.0, 9)[:, None]
            points.append(line[:2] + share * (line[2:] - line[:2]))
            radii.append(np.full(9, 0.02))
        away = np.concatenate(points) - (x, y)
        radius = np.concatenate(radii)
        cos, sin = math.cos(theta), math.sin(theta)
        ahead, left = away @ (cos, sin), away @ (-sin, cos)
        in_the_way = (ahead > 0) & (np.abs(left) < self._side + radius + 0.08)
        if not in_the_way.any():
            return 1.0
        gap = float((ahead - radius)[in_the_way].min()) - self._front
        return min(max((gap - KEEPS) / SLOWS, 0.0), 1.0)

    def _leaf_ends(self) -> NDArray[np.float64]:
        return np.array([leaf.ends for leaf in self._leaves], np.float64).reshape(-1, 4)


def _crowd(scenario: Scenario, world: World, rng: np.random.Generator) -> list[Person]:
    """The people of the crowd, each with the place it begins at."""
    crowd = scenario.crowd
    if crowd is None:
        return []
    start = scenario.start[:2]
    x0, y0, x1, y1 = world.bounds
    true = true_map(world, max(0.2, (x1 - x0) / 2000, (y1 - y0) / 2000), seen_from=start)
    places = rng.permutation(true.centres(np.argwhere(true.cells == FREE)))
    taken = [*(person.waypoints[0] for person in scenario.people)]
    found: list[Person] = []
    for begin in range(0, len(places), 500):
        some = places[begin : begin + 500]
        for place in some[world.is_free(some, CROWD_CLEARANCE)]:
            near = [math.dist(place, other) < 1.0 for other in taken]
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
