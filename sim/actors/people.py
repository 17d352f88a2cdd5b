"""People in the physics engine: they walk towards their next waypoint, keep away from each other, and bump.

Each wants to walk towards its waypoint at its speed, and is pushed by what is near, more the nearer it is (the
social force model of Helbing and Molnar 1995, here on velocities). Two who meet head-on both pass on the right. A
person who gets nowhere for three seconds chooses another waypoint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE
from moteslam.robot.se2 import Array
from moteslam.robot.values import Number, Positive, Section, Truth, Whole
from moteslam.sim.world.pieces import Point
from moteslam.sim.world.world import World, true_map

if TYPE_CHECKING:
    import pymunk


MAX_PEOPLE = 60  # In a scenario: every beam is tested against each of them
PEOPLE, ROBOT = 0b10, 0b100  # The physics engine's categories of shapes that are no walls
MASS = 75.0  # Of a person [kg]
AGILITY = 2.0  # How fast a person changes its velocity [m/s^2]
PUSH, PUSH_RANGE = 1.5, 0.3  # Push of what touches a person [m/s], and the gap over which it fades to 1/e [m]
WALL_PUSH, WALL_RANGE = 0.8, 0.12  # The same of walls [m/s], [m]
PATIENCE, PROGRESS = 3.0, 0.3  # Who has moved less than the second [m] in this time [s] chooses another waypoint
ARRIVED = 0.35  # Within this distance of a waypoint a person has arrived [m]
STROLL = (2.0, 8.0)  # Shortest and longest leg of a stroller [m]

Speed = Annotated[Number, Field(gt=0, le=3)]
Time = Annotated[Number, Field(ge=0, le=1800)]


class Person(Section):
    """Somebody who walks from waypoint to waypoint, there and back again, round the robot and others."""

    # [m], the first is the start; with a single one they stroll to places that the seed chooses
    waypoints: Annotated[tuple[Point, ...], Field(min_length=1, max_length=1000)]
    speed: Speed = 1.2  # of their walk [m/s] (1.34 is the usual one, Helbing and Molnar 1995)
    pause: Time = 0.5  # how long they stand at each waypoint [s]
    start: Time = 0.0  # and at the first [s]
    radius: Annotated[Number, Field(ge=0.1, le=0.5)] = 0.22  # of the body [m]
    legs: Truth = True  # whether the lidar sees two legs that stride, or one disc
    leg: Annotated[Number, Field(ge=0.03, le=0.2)] = 0.07  # radius of a leg [m]


class Walkers:
    """All the people of a scenario, in the physics engine's space; ``rng`` is of where strollers go."""

    def __init__(
        self, persons: tuple[Person, ...], world: World, space: pymunk.Space, rng: np.random.Generator
    ) -> None:
        import pymunk

        self._persons, self._world, self._space, self._rng = persons, world, space, rng
        self.radii = np.array([person.radius for person in persons])
        self._speeds = np.array([person.speed for person in persons])
        self._bodies: list[pymunk.Body] = []
        for person in persons:
            body = pymunk.Body(MASS, float("inf"))
            body.position = person.waypoints[0]
            shape = pymunk.Circle(body, person.radius)
            shape.friction = 0.2
            shape.filter = pymunk.ShapeFilter(categories=PEOPLE)
            space.add(body, shape)
            self._bodies.append(body)
        count = len(persons)
        self._next = [0] * count
        self._direction = [1] * count
        self._targets = self.places.copy()
        self._wait_until = np.array([person.start for person in persons])
        self._checked = np.zeros(count)
        self._checked_at = self.places.copy()
        self._walls = pymunk.ShapeFilter(mask=pymunk.ShapeFilter.ALL_MASKS() ^ (PEOPLE | ROBOT))

    @property
    def places(self) -> Array:
        """Their centres [p, 2] [m]."""
        return np.array([tuple(body.position) for body in self._bodies], np.float64).reshape(-1, 2)

    def walk(self, time: float, interval: float, robot: tuple[float, float], robot_radius: float) -> None:
        """Choose their velocities for the next interval [s], given where the robot is and its radius [m]."""
        places = self.places
        self._choose_targets(time, places)
        offset = self._targets - places
        distance = np.hypot(*offset.T)
        walking = time >= self._wait_until
        wanted = offset / np.maximum(distance, 1e-6)[:, None] * (self._speeds * walking)[:, None]
        wanted += self._pushes(places, wanted, np.asarray(robot), robot_radius)
        for i, body in enumerate(self._bodies):
            wish = wanted[i] + self._wall_push(places[i], self._persons[i].radius)
            size = float(np.hypot(*wish))
            wish *= min(1.0, 1.3 * self._speeds[i] / max(size, 1e-9))
            change = wish - np.array(tuple(body.velocity))
            share = min(1.0, AGILITY * interval / max(float(np.hypot(*change)), 1e-9))
            x, y = (np.array(tuple(body.velocity)) + share * change).tolist()
            body.velocity = (x, y)

    def _pushes(self, places: Array, wanted: Array, robot: Array, robot_radius: float) -> Array:
        """What the others and the robot add to each one's velocity [p, 2] [m/s]."""
        centres = np.concatenate((places, robot[None]))
        radii = np.append(self.radii, robot_radius)
        away = places[:, None] - centres
        apart = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-6)
        gap = apart - radii - self.radii[:, None]
        strength = PUSH * np.exp(-np.maximum(gap, 0.0) / PUSH_RANGE)
        strength[np.arange(len(places)), np.arange(len(places))] = 0.0
        direction = away / apart[..., None]
        push = (strength[..., None] * direction).sum(1)
        # to the right of the direction of walking, by the share of the push that comes from ahead
        right = np.stack((wanted[:, 1], -wanted[:, 0]), axis=-1) / np.maximum(np.hypot(*wanted.T), 1e-6)[:, None]
        ahead = np.maximum(-(direction * wanted[:, None]).sum(-1) / np.maximum(self._speeds, 1e-6)[:, None], 0.0)
        return np.asarray(push + right * (strength * ahead).sum(1)[:, None])

    def _wall_push(self, place: Array, radius: float) -> Array:
        found = self._space.point_query_nearest((float(place[0]), float(place[1])), radius + 0.4, self._walls)
        if found is None:
            return np.zeros(2)
        away = np.array(tuple(found.gradient))
        return np.asarray(WALL_PUSH * np.exp(-max(found.distance - radius, 0.0) / WALL_RANGE) * away)

    def _choose_targets(self, time: float, places: Array) -> None:
        for i, person in enumerate(self._persons):
            if time < self._wait_until[i]:
                self._checked[i], self._checked_at[i] = time, places[i]
                continue
            there = np.hypot(*(self._targets[i] - places[i])) < ARRIVED
            due = time > self._checked[i] + PATIENCE
            lost = due and np.hypot(*(places[i] - self._checked_at[i])) < PROGRESS
            if due:
                self._checked[i], self._checked_at[i] = time, places[i]
            if not (there or lost):
                continue
            if len(person.waypoints) == 1:
                self._targets[i] = self._stroll(places[i], person.radius)
            else:
                if lost or not 0 <= self._next[i] + self._direction[i] < len(person.waypoints):
                    self._direction[i] *= -1
                self._next[i] = int(np.clip(self._next[i] + self._direction[i], 0, len(person.waypoints) - 1))
                self._targets[i] = person.waypoints[self._next[i]]
            if there and time > person.start:
                self._wait_until[i] = time + person.pause

    def _stroll(self, place: Array, radius: float) -> Array:
        """A place in view, or the same place where none is found."""
        for attempt in range(40):
            length = self._rng.uniform(*STROLL) / (1 + attempt // 10)
            angle = self._rng.uniform(-np.pi, np.pi)
            end = place + length * np.array((np.cos(angle), np.sin(angle)))
            points = np.linspace(place, end, max(2, int(length / 0.1)))
            if self._world.is_free(points[5:], radius + 0.1).all():
                return np.asarray(end)
        return place


CLEARANCE = 0.45  # From walls, where people of a crowd begin [m]
APART = 1.0  # Between two places where people begin [m]


class Crowd(Section):
    """People whom the seed puts anywhere free, and who stroll about."""

    count: Annotated[Whole, Field(ge=1, le=MAX_PEOPLE)]
    speed: tuple[Speed, Speed] = (0.8, 1.4)  # each one's is drawn between these [m/s]
    away: Positive = 2.0  # smallest distance from the robot's start at which they begin [m]

    @model_validator(mode="after")
    def _makes_sense(self) -> Crowd:
        if self.speed[0] > self.speed[1]:
            raise ValueError(f"speed from {self.speed[0]:g} to {self.speed[1]:g} m/s, expected the first to be smaller")
        return self


def place_crowd(
    crowd: Crowd, world: World, start: Array, others: Sequence[Person], rng: np.random.Generator
) -> list[Person]:
    """The people of a crowd, each where it begins: in reach of the robot's ``start`` [m], apart from ``others``."""
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
                x, y = place.tolist()
                speed, pause = float(rng.uniform(*crowd.speed)), float(rng.uniform(0.0, 3.0))
                found.append(Person(waypoints=((x, y),), speed=speed, pause=pause))
                taken.append((x, y))
        if len(found) == crowd.count:
            return found
    raise ConfigError(
        f"room for {len(found)} of {crowd.count} people, expected fewer, or more free space", field="crowd.count"
    )
