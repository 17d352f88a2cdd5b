"""The people and doors of a scenario, moved together in the robot's physics engine, and their tracks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.se2 import Array
from moteslam.robot.values import Number, Section, Summarised, Truth
from moteslam.sim.actors.people import Crowd, Person, Walkers, place_crowd
from moteslam.sim.world.pieces import PLAIN, Point
from moteslam.sim.world.world import World, check_legs, check_place

if TYPE_CHECKING:
    import pymunk


TRUTH_RATE = 100  # Places of people and doors, and true poses of the robot, that are kept a second [Hz]
STEP_LENGTH = 0.7  # Of a walking person: from one footprint to the next [m]
STRIDE = 0.18  # How far a leg swings forward and back, at the lidar's height [m]
LEGS_APART = 0.11  # Of each leg from the middle [m]


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Summarised):
    """Discs (legs, bodies) and lines (doors' leaves) at ``rate`` [Hz] from ``begin`` [s] of the drive on.

    Between two samples everything is taken to move straight: at 2 m/s^2 that is off by 25 micrometres.
    """

    rate: float  # [Hz]
    discs: NDArray[np.float32]  # [t, k, 3] x, y, radius [m]
    lines: NDArray[np.float32]  # [t, m, 4] x0, y0, x1, y1 [m]
    surfaces: NDArray[np.int16]  # [m] what the lines are made of, as in the world's palette
    people: Array  # [t, p, 2] the people's centres [m]
    begin: float = 0.0


def _legs(path: Array, walked: Array, radius: float) -> Array:
    """Two legs [t, 2, 3] that swing in turns with the distance walked [t], side by side while standing."""
    from scipy.ndimage import uniform_filter1d

    velocity = uniform_filter1d(np.gradient(path, axis=0) * TRUTH_RATE, max(1, TRUTH_RATE // 2), axis=0, mode="nearest")
    speed = np.hypot(*velocity.T)
    walking = speed > 0.1
    last = np.maximum.accumulate(np.where(walking, np.arange(len(path)), 0))
    heading = np.arctan2(velocity[last, 1], velocity[last, 0])
    swing = STRIDE * np.minimum(speed / 0.6, 1.0) * np.sin(np.pi * walked / STEP_LENGTH)
    ahead = np.stack((np.cos(heading), np.sin(heading)), axis=-1)
    left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=-1)
    legs = [path + side * (LEGS_APART * left + swing[:, None] * ahead) for side in (1.0, -1.0)]
    return np.concatenate((np.stack(legs, axis=1), np.full((len(path), 2, 1), radius)), axis=-1)


MAX_DOORS = 60  # In a scenario: every beam is tested against each of them
CLEAR = 0.12  # A leaf stops this far from anyone [m]


class Door(Section):
    """A door's leaf that opens and shuts, by the clock or at random."""

    hinge: Point  # one end of the leaf [m]
    end: Point  # the other when it is shut [m]
    kind: Literal["swing", "slide"] = "swing"  # swing: turns about its hinge; slide: moves along itself past the hinge
    # how far it swings [rad], counterclockwise positive
    opening: Annotated[Number, Field(ge=-math.pi, le=math.pi)] = math.pi / 2
    # in turns, beginning shut [s]: durations, or with `random` means (exponential)
    shut_for: Annotated[Number, Field(gt=0, le=3600)] = 10.0
    open_for: Annotated[Number, Field(gt=0, le=3600)] = 10.0
    random: Truth = False
    automatic: Truth = True  # whether it opens for anyone within sensor [m] of its middle
    sensor: Annotated[Number, Field(gt=0, le=10)] = 2.0
    takes: Annotated[Number, Field(ge=0.2, le=60)] = 1.5  # time to open or shut [s]. It does not shut on anyone
    material: str = PLAIN

    @model_validator(mode="after")
    def _has_a_leaf_that_moves(self) -> Door:
        if math.dist(self.hinge, self.end) < 0.05:
            raise ValueError("a leaf under 0.05 m wide, expected hinge and end apart")
        if self.kind == "slide" and self.opening != math.pi / 2:  # the default is written with every door
            raise ValueError('an opening of a door that slides, expected kind = "swing" or no opening')
        return self


class Leaf:
    """The leaf of a door in the physics engine, with a schedule that covers ``duration`` [s]."""

    def __init__(self, door: Door, space: pymunk.Space, duration: float, rng: np.random.Generator) -> None:
        import pymunk

        self._door, self._space = door, space
        self._hinge = np.asarray(door.hinge)
        self._along = np.asarray(door.end) - self._hinge
        self.width = float(np.hypot(*self._along))
        self._angle = math.atan2(self._along[1], self._along[0])
        self._body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        shape = pymunk.Segment(self._body, (0.0, 0.0), (self.width, 0.0), 0.01)
        shape.friction = 0.2
        space.add(self._body, shape)
        self._switches = _schedule(door, duration, rng)
        self.open = 0.0
        self._place()

    def ends(self, opened: float) -> Array:
        """x0, y0, x1, y1 of the leaf when it is open so far, 0 to 1 [m]."""
        if self._door.kind == "slide":
            shift = -opened * self._along
            return np.concatenate((self._hinge + shift, self._hinge + self._along + shift))
        angle = self._angle + opened * self._door.opening
        tip = self._hinge + self.width * np.array((math.cos(angle), math.sin(angle)))
        return np.concatenate((self._hinge, tip))

    def move(self, time: float, interval: float, bodies: Array, radii: Array) -> None:
        """Move for an interval [s], with people and robot at ``bodies`` [n, 2] of ``radii`` [n] [m]."""
        from_middle = np.hypot(*(bodies - (self._hinge + self._along / 2)).T)
        door = self._door
        wanted = bool(np.searchsorted(self._switches, time, "right") % 2)
        wanted |= door.automatic and bool((from_middle < door.sensor).any())
        if not wanted and (from_middle - radii < self.width / 2 + CLEAR).any():
            return  # someone stands in it
        step = interval / door.takes
        after = min(max(self.open + (step if wanted else -step), 0.0), 1.0)
        if after == self.open:
            return
        near = _distance(bodies, self.ends(after)) - radii
        if ((near < CLEAR) & (near < _distance(bodies, self.ends(self.open)) - radii)).any():
            return  # it would come nearer to someone who is near already
        self.open = after
        self._place()

    def _place(self) -> None:
        x0, y0, x1, y1 = self.ends(self.open).tolist()
        self._body.position, self._body.angle = (x0, y0), math.atan2(y1 - y0, x1 - x0)
        self._space.reindex_shapes_for_body(self._body)


def _schedule(door: Door, duration: float, rng: np.random.Generator) -> Array:
    """When the door opens, shuts, opens ... [s]."""
    switches: list[float] = []
    time, spans = 0.0, (door.shut_for, door.open_for)
    while time < duration:
        span = spans[len(switches) % 2]
        time += max(float(rng.exponential(span)), 0.5) if door.random else span
        switches.append(time)
    return np.array(switches)


def _distance(points: Array, line: NDArray[Any]) -> Array:
    """Of points [n, 2] from a segment [m]."""
    a, along = line[:2], line[2:] - line[:2]
    share = np.clip(((points - a) @ along) / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(points - a - share[:, None] * along).T))


LEAF_POINTS, LEAF_RADIUS = 9, 0.02  # A leaf is this many discs of this radius [m] to who drives towards it


class Actors:
    """The people with waypoints, the crowd, whom the seed places, and the doors of a scenario, in a physics engine's
    space.

    The robot starts at ``start`` [2] [m], of a run of ``duration`` at most [s].
    """

    def __init__(
        self,
        people: Sequence[Person],
        crowd: Crowd | None,
        doors: Sequence[Door],
        *,
        world: World,
        space: pymunk.Space,
        start: Array,
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
        self._places: list[Array] = []
        self._ends: list[Array] = []
        self._walked = [np.zeros(len(self.persons))]  # by everyone until each place [m]

    def move(self, time: float, interval: float, robot: tuple[float, float], robot_radius: float) -> None:
        """Let everyone choose a motion for the next interval [s], given where the robot is [m] and its radius [m]."""
        bodies = np.concatenate((self._walkers.places, np.array(robot)[None]))
        radii = np.append(self._walkers.radii, robot_radius)
        for leaf in self._leaves:
            leaf.move(time, interval, bodies, radii)
        if self.persons:
            self._walkers.walk(time, interval, robot, robot_radius)

    def record(self) -> None:
        places = self._walkers.places
        if self._places:
            self._walked.append(self._walked[-1] + np.hypot(*(places - self._places[-1]).T))
        self._places.append(places)
        self._ends.append(self._leaf_ends())

    def tracks(self, seconds: float | None = None) -> Tracks:
        """Everything that was recorded, or its latest part of so many seconds."""
        first = 0 if seconds is None else max(len(self._places) - round(seconds * TRUTH_RATE), 0)
        places, walked = np.array(self._places[first:]), np.array(self._walked[first:])
        discs = [np.empty((len(places), 0, 3))]
        for i, person in enumerate(self.persons):
            if person.legs:
                discs.append(_legs(places[:, i], walked[:, i], person.leg))
            else:
                radius = np.full((len(places), 1), person.radius)
                discs.append(np.concatenate((places[:, i], radius), axis=1)[:, None])
        return Tracks(
            float(TRUTH_RATE),
            np.ascontiguousarray(np.concatenate(discs, axis=1), np.float32),
            np.ascontiguousarray(self._ends[first:], np.float32),
            np.asarray(self._surfaces, np.int16),
            places,
            first / TRUTH_RATE,
        )

    def obstacles(self) -> tuple[Array, Array]:
        """People and leaves as discs: their centres [n, 2] and radii [n] [m]."""
        points = [self._walkers.places]
        radii = [self._walkers.radii]
        for line in self._leaf_ends():
            share = np.linspace(0.0, 1.0, LEAF_POINTS)[:, None]
            points.append(line[:2] + share * (line[2:] - line[:2]))
            radii.append(np.full(LEAF_POINTS, LEAF_RADIUS))
        return np.concatenate(points), np.concatenate(radii)

    def _leaf_ends(self) -> Array:
        return np.array([leaf.ends(leaf.open) for leaf in self._leaves], np.float64).reshape(-1, 4)


def check_people(people: Sequence[Person], world: World, start: Array, radius: float) -> None:
    """Refuse people who walk into walls, or begin on each other or on the robot of a radius at ``start`` [2] [m]."""
    for i, person in enumerate(people):
        places = np.asarray(person.waypoints)
        for j, place in enumerate(places):
            check_place(world, place, person.radius, field=f"people.{i}.waypoints.{j}", what="the person")
        check_legs(world, places, person.radius, field=f"people.{i}.waypoints")
        others = [("the robot", start, radius)]
        others += [(f"people.{j}", np.asarray(one.waypoints[0]), one.radius) for j, one in enumerate(people[:i])]
        for name, place, size in others:
            if np.hypot(*(places[0] - place)) < person.radius + size:
                problem = f"the person begins where {name} does, expected them apart"
                raise ConfigError(problem, field=f"people.{i}.waypoints.0")


def check_doors(doors: Sequence[Door], world: World, start: Array, radius: float) -> None:
    """Refuse doors of an unknown material, or shut across the robot of a radius at ``start`` [2] [m]."""
    for i, door in enumerate(doors):
        if door.material not in world.palette:
            raise ConfigError(
                f"{door.material!r}, expected one of {', '.join(world.palette)}", field=f"doors.{i}.material"
            )
        away = float(World(np.array([(*door.hinge, *door.end)])).distance(start)[0])
        if away < radius:
            problem = f"the shut leaf is {away:.2f} m from where the robot starts, expected at least {radius:.2f} m"
            raise ConfigError(problem, field=f"doors.{i}")
