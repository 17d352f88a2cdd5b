"""What the robot is asked to do: follow a route, wander, or obey commands; the driver for it, and its checks."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.platform import Platform
from moteslam.robot.values import Number, Positive, Section, Truth
from moteslam.sim.robot.driver import MAX_DURATION, Driver, Limits, PathDriver
from moteslam.sim.world.pieces import Point
from moteslam.sim.world.world import World, check_legs, check_place


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

    @property
    def start_pose(self) -> NDArray[np.float64]:
        """X [m], y [m], theta [rad]: on the first waypoint, heading for the second."""
        first, second = self.corners[:2]
        return np.array((*first, np.arctan2(*(second - first)[::-1])))

    def path(self) -> NDArray[np.float64]:
        """The corners [k, 2] of all the laps, the last lap cut where it ends."""
        lap = self.corners
        if not self.closed:
            return lap
        complete = int(self.laps)
        corners = np.concatenate([lap[:-1]] * complete + [lap])
        length = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
        end = self.laps * length[len(lap) - 1]
        kept = length < end - 1e-9
        last = [np.interp(end, length, corners[:, axis]) for axis in (0, 1)]
        return np.concatenate((corners[kept], [last]))


_TRIES = 2000


class Wander(Section):
    """A path of straight legs between places chosen at random (by the seed) in view of each other.

    Attributes:
        distance: to drive at least [m].
        leg: shortest and longest leg [m].
        clearance: from the walls [m].
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

    @property
    def start_pose(self) -> NDArray[np.float64]:
        """X [m], y [m], theta [rad]: heading along x."""
        return np.array((*self.start, 0.0))


def wander_path(wander: Wander, world: World, rng: np.random.Generator) -> NDArray[np.float64]:
    """The corners [k, 2] [m] of a path of at least ``wander.distance``.

    Each leg leads in a random direction, turning back only where nothing else is free.
    """
    shortest, longest = wander.leg
    corners, driven, heading = [np.asarray(wander.start, np.float64)], 0.0, 0.0
    while driven < wander.distance:
        for attempt in range(_TRIES):
            length = rng.uniform(shortest, longest)
            turn = rng.uniform(-1, 1) * np.pi * min(1.0, 0.5 + attempt / 50)
            step = length * np.array((np.cos(heading + turn), np.sin(heading + turn)))
            samples = np.linspace(corners[-1], corners[-1] + step, max(2, int(length / 0.1)))
            if world.is_free(samples[1:], wander.clearance).all():
                break
        else:
            x, y = corners[-1]
            raise ConfigError(
                f"no free leg of {shortest:g} to {longest:g} m leads on from ({x:.2f}, {y:.2f}), "
                "expected more room, shorter legs or less clearance",
                field="wander",
            )
        corners.append(samples[-1])
        driven, heading = driven + length, heading + turn
    return np.array(corners)


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
    path: NDArray[np.float64] | None = None

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


Task = Route | Wander | Commands


def driver_for(task: Task, limits: Limits, world: World, rng: np.random.Generator) -> Driver:
    """The driver that does a task; ``rng`` is of its inattention and, for a wander, of its path."""
    match task:
        case Commands():
            return BlindDriver(task)
        case Route():
            return PathDriver(task.path(), limits, rng)
        case Wander():
            return PathDriver(wander_path(task, world, rng), limits, rng)


def check_duration(task: Task, limits: Limits, duration: float) -> None:
    """Refuse a run [s] that is too short for its rests and its task."""
    distance = 0.0
    if isinstance(task, Route):
        distance = float(np.hypot(*np.diff(task.path(), axis=0).T).sum())
    elif isinstance(task, Wander):
        distance = task.distance
    rests, driving = limits.rest_start + limits.rest_end, distance / limits.speed
    if duration <= rests or duration < rests + driving:
        problem = f"{duration:g} s, expected more than {rests:g} s of rests and {driving:.0f} s for {distance:.0f} m"
        raise ConfigError(problem, field="duration")


def check_task(task: Task, world: World, platform: Platform) -> None:
    """Refuse a start, waypoint or leg in a wall, or too near to one for the robot."""
    if isinstance(task, Route):
        for i, point in enumerate(task.waypoints):
            check_place(world, point, platform.radius, field=f"route.waypoints.{i}", what="the robot")
        check_legs(world, task.corners, platform.width / 2, field="route.waypoints")
    else:
        field = f"{type(task).__name__.lower()}.start"
        check_place(world, task.start[:2], platform.radius, field=field, what="the robot")
