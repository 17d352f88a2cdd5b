"""What the robot is asked to do, and its drivers: pure pursuit along a path, commands, and how they mind who is ahead.

The driver of the real robot saw where it was, and so does a simulated one. SLAM is given the sensors' readings.
"""

import math
from typing import Annotated, Protocol, Self

import numpy as np
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.platform import Platform
from moteslam.robot.se2 import Array
from moteslam.robot.values import Angle, Number, Positive, Section, Truth
from moteslam.sim.world.pieces import Point
from moteslam.sim.world.world import World, check_legs, check_place

MAX_DURATION = 12_000.0  # Longest recording [s], for 2 km at 0.2 m/s; of `ucsd` 480 000 scans, 2.1 GB of ranges

Seconds = Annotated[Number, Field(ge=0, le=MAX_DURATION)]


class Limits(Section):
    speed: Annotated[Number, Field(gt=0, le=3)] = 0.95  # at most [m/s]
    turn_rate: Annotated[Number, Field(gt=0, le=3)] = 1.0  # at most [rad/s]
    acceleration: Annotated[Number, Field(gt=0, le=5)] = 0.8  # at most [m/s^2]
    turn_acceleration: Annotated[Number, Field(gt=0, le=10)] = 2.5  # at most [rad/s^2]
    lookahead: Annotated[Number, Field(gt=0, le=5)] = 0.7  # distance ahead on the route that is aimed at [m]
    # standard deviation of the driver's sideways inattention [m], over wander_distance [m]
    wander: Annotated[Number, Field(ge=0, le=1)] = 0.03
    wander_distance: Positive = 2.0
    rest_start: Seconds = 6.0  # standing still before [s]: long enough to see the gyro's bias
    rest_end: Seconds = 4.0  # and after [s]


class Driver(Protocol):
    looks: bool  # whether it slows down for people and doors, and gives up where it does not get on
    path: Array | None  # the points [n, 2] that it drives along [m]; None without a path
    at: int  # the index of where it is on its path; set where it is to go on from another place

    def command(self, time: float, x: float, y: float, theta: float) -> tuple[float, float] | None:
        """The speed [m/s] and turn rate [rad/s] to ask for at a time [s since the rest ended] and true pose.

        None when the driver has arrived.
        """
        ...

    @property
    def done(self) -> float:
        """The share of the path or time that lies behind."""
        ...


SPACING = 0.05  # Between the points that a path is sampled at [m]


class PathDriver:
    """Pure pursuit (Coulter 1992) of corners [k, 2] [m]: aim at the point of the path a look-ahead distance on.

    Slows down before the end, and in bends to the speed that its turn rate allows; turns nearly on the spot to a point
    well to the side or behind. A smooth sideways error, drawn from ``rng``, keeps it from driving like a tram.
    """

    looks = True

    def __init__(self, path: Array, limits: Limits, rng: np.random.Generator) -> None:
        points, length = sampled(path)
        points = points + _sway(points, length, limits, rng)
        self.path: Array | None = points
        self._x, self._y = points.T.tolist()
        self._limits = limits
        self.at = 0
        self._ahead = max(1, round(limits.lookahead / SPACING))

    def command(self, time: float, x: float, y: float, theta: float) -> tuple[float, float] | None:
        """See `Driver`; arrived when the nearest point ahead is the last, or the last is hardly reachable."""
        limits, last = self._limits, len(self._x) - 1
        self.at = min(
            range(self.at, min(self.at + 2 * self._ahead, last) + 1),
            key=lambda i: (self._x[i] - x) ** 2 + (self._y[i] - y) ** 2,
        )
        left = (last - self.at) * SPACING
        target = min(self.at + self._ahead, last)
        dx, dy = self._x[target] - x, self._y[target] - y
        distance = math.hypot(dx, dy)
        bearing = math.remainder(math.atan2(dy, dx) - theta, math.tau)
        if left < SPACING or (target == last and distance < 0.3 and abs(bearing) > 1.5):
            return None
        stopping = math.sqrt(2 * limits.acceleration * 0.7 * max(distance if target == last else left, 0.0)) + 0.02
        if abs(bearing) > 1.2:
            return 0.05, math.copysign(limits.turn_rate, bearing)
        curvature = 2 * math.sin(bearing) / max(distance, 0.2)
        speed = min(limits.speed, stopping, limits.speed * math.cos(bearing) ** 2)
        speed = min(speed, limits.turn_rate / max(abs(curvature), 1e-9))
        return speed, speed * curvature

    @property
    def done(self) -> float:
        return self.at / (len(self._x) - 1)


def sampled(path: Array) -> tuple[Array, Array]:
    """The path at every ``SPACING`` of its length, its end included: points [n, 2], length up to each [n] [m]."""
    corners = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    length = np.linspace(0.0, corners[-1], max(2, round(corners[-1] / SPACING) + 1))
    return np.stack([np.interp(length, corners, path[:, axis]) for axis in (0, 1)], axis=-1), length


def _sway(points: Array, length: Array, limits: Limits, rng: np.random.Generator) -> Array:
    """A smooth sideways error [n, 2] [m], none at the first point."""
    knots = np.arange(0.0, length[-1] + 2 * limits.wander_distance, limits.wander_distance)
    error = limits.wander * rng.standard_normal(len(knots))
    error[0] = 0.0
    # half-cosine between the knots: smooth, and never beyond them
    share = length / limits.wander_distance
    i = np.minimum(share.astype(int), len(knots) - 2)
    blend = (1 - np.cos(np.pi * (share - i))) / 2
    sideways = error[i] * (1 - blend) + error[i + 1] * blend
    heading = np.gradient(points, axis=0)
    heading /= np.maximum(np.hypot(*heading.T)[:, None], 1e-12)
    left = np.stack((-heading[:, 1], heading[:, 0]), axis=-1)
    return np.asarray(left * sideways[:, None], np.float64)


STOP_GAP, SLOW_GAP = 0.25, 0.9  # The robot stops with the first gap to who is ahead; over the second it slows down [m]
SIDE_GAP = 0.08  # Who leaves less than this beside the robot is in its path [m]
PATIENCE = 60.0  # How long a driver waits for its path to become free [s]


def pace(pose: tuple[float, float, float], platform: Platform, centres: Array, radii: Array) -> float:
    """The share of its speed that the robot drives at among discs at ``centres`` [n, 2] of ``radii`` [n] [m]."""
    x, y, theta = pose
    away = centres - (x, y)
    cos, sin = math.cos(theta), math.sin(theta)
    ahead, left = away @ (cos, sin), away @ (-sin, cos)
    in_path = (ahead > 0) & (np.abs(left) < platform.width / 2 + radii + SIDE_GAP)
    if not in_path.any():
        return 1.0
    gap = float((ahead - radii)[in_path].min()) - platform.length / 2
    return min(max((gap - STOP_GAP) / SLOW_GAP, 0.0), 1.0)


class Route(Section):
    """Waypoints that are driven past in order, in straight legs with rounded corners."""

    # [m]; the robot starts on the first, heading for the second
    waypoints: Annotated[tuple[Point, ...], Field(min_length=2, max_length=10_000)]
    closed: Truth = False  # whether the last leads back to the first
    laps: Annotated[Number, Field(gt=0, le=100)] = 1.0  # how many times round a closed route, parts of a lap included

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.laps != 1.0 and not self.closed:
            raise ValueError("laps of an open route, expected closed = true or no laps")
        if (np.hypot(*np.diff(self.corners, axis=0).T) == 0).any():
            raise ValueError("two successive waypoints are the same, expected them apart")
        return self

    @property
    def corners(self) -> Array:
        """The corners [k, 2] of one lap, the first repeated at the end if it is closed."""
        points = (*self.waypoints, self.waypoints[0]) if self.closed else self.waypoints
        return np.asarray(points, np.float64)

    @property
    def start_pose(self) -> Array:
        """X [m], y [m], theta [rad]: on the first waypoint, heading for the second."""
        first, second = self.corners[:2]
        return np.array((*first, np.arctan2(*(second - first)[::-1])))

    def path(self) -> Array:
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
    """A path of straight legs between places chosen at random (by the seed) in view of each other."""

    start: Point
    distance: Annotated[Number, Field(gt=0, le=5000)]  # to drive at least [m]
    leg: tuple[Positive, Positive] = (2.0, 8.0)  # shortest and longest leg [m]
    clearance: Positive = 0.6  # from the walls [m]

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.leg[0] >= self.leg[1]:
            raise ValueError(f"leg from {self.leg[0]:g} to {self.leg[1]:g} m, expected the first to be smaller")
        return self

    @property
    def start_pose(self) -> Array:
        """X [m], y [m], theta [rad]: heading along x."""
        return np.array((*self.start, 0.0))


def wander_path(wander: Wander, world: World, rng: np.random.Generator) -> Array:
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

    start: tuple[Number, Number, Angle]
    steps: Annotated[tuple[Command, ...], Field(min_length=1, max_length=10_000)]

    @property
    def start_pose(self) -> Array:
        """X [m], y [m], theta [rad]."""
        return np.asarray(self.start, np.float64)


class BlindDriver:
    """Follows commands in order, whatever happens; see `Driver`."""

    looks = False
    path: Array | None = None

    def __init__(self, commands: Commands) -> None:
        self.at = 0
        self._steps = commands.steps
        self._ends = np.cumsum([step.duration for step in commands.steps])
        self._time = 0.0

    def command(self, time: float, x: float, y: float, theta: float) -> tuple[float, float] | None:
        self._time = time
        i = int(np.searchsorted(self._ends, time, "right"))
        return None if i == len(self._steps) else (self._steps[i].speed, self._steps[i].turn_rate)

    @property
    def done(self) -> float:
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
        problem = f"{duration:g} s, expected more: {distance:.0f} m take {driving:.0f} s, and rests {rests:g} s"
        raise ConfigError(problem, field="duration")


def check_moves(limits: Limits, duration: float) -> None:
    """Refuse a run [s] that ends before the robot has moved."""
    if duration <= (rests := limits.rest_start + limits.rest_end):
        problem = f"{duration:g} s, expected more than {rests:g} s: drive.rest_start and drive.rest_end"
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
