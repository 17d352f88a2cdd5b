"""The people and doors of a scenario, moved together in the robot's physics engine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moteslam.sim.actors.crowd import Crowd, place_crowd
from moteslam.sim.actors.doors import Door, Leaf
from moteslam.sim.actors.people import Person, Walkers
from moteslam.sim.actors.tracks import Tracks, tracks_of
from moteslam.sim.world.world import World

if TYPE_CHECKING:
    import pymunk

LEAF_POINTS, LEAF_RADIUS = 9, 0.02
"""A leaf is this many discs of this radius [m] to who drives towards it."""


class Actors:
    """The people and doors of a scenario.

    Args:
        people: with waypoints of their own.
        crowd: more people, whom the seed places.
        doors: all of them.
        world: it takes place in.
        space: of the physics engine, which they are put into.
        start: [2] where the robot starts [m].
        duration: of the run at most [s].
        rng: of schedules, strolls and the crowd.

    Raises:
        ConfigError: no room for the crowd.
    """

    def __init__(
        self,
        people: Sequence[Person],
        crowd: Crowd | None,
        doors: Sequence[Door],
        *,
        world: World,
        space: pymunk.Space,
        start: NDArray[np.float64],
        duration: float,
        rng: np.random.Generator,
    ) -> None:
        doors_rng, crowd_rng, strolls_rng = rng.spawn(3)
        strollers = [] if crowd is None else place_crowd(crowd, world, start, people, crowd_rng)
        self.persons = (*people, *strollers)
        self._leaves = [Leaf(door, space, duration, doors_rng) for door in doors]
        names = list(world.palette)
        self._surfaces = [names.index(door.material) for door in doors]
        self._walkers = Walkers(self.persons, world, space, strolls_rng)
        self._places: list[NDArray[np.float64]] = []
        self._ends: list[NDArray[np.float64]] = []

    def move(self, time: float, interval: float, robot: tuple[float, float], robot_radius: float) -> None:
        """Let everyone choose a motion for the next interval [s], given where the robot is [m] and its radius [m]."""
        bodies = np.concatenate((self._walkers.places, np.array(robot)[None]))
        radii = np.append(self._walkers.radii, robot_radius)
        for leaf in self._leaves:
            leaf.move(time, interval, bodies, radii)
        if self.persons:
            self._walkers.walk(time, interval, robot, robot_radius)

    def record(self) -> None:
        """Add the present places to the tracks."""
        self._places.append(self._walkers.places)
        self._ends.append(self._leaf_ends())

    def tracks(self) -> Tracks:
        """Everything that was recorded."""
        return tracks_of(self.persons, np.array(self._places), np.array(self._ends), self._surfaces)

    def obstacles(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """People and leaves as discs: their centres [n, 2] and radii [n] [m]."""
        points = [self._walkers.places]
        radii = [self._walkers.radii]
        for line in self._leaf_ends():
            share = np.linspace(0.0, 1.0, LEAF_POINTS)[:, None]
            points.append(line[:2] + share * (line[2:] - line[:2]))
            radii.append(np.full(LEAF_POINTS, LEAF_RADIUS))
        return np.concatenate(points), np.concatenate(radii)

    def _leaf_ends(self) -> NDArray[np.float64]:
        return np.array([leaf.ends for leaf in self._leaves], np.float64).reshape(-1, 4)
