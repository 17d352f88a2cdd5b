"""Intervals of a drive, and what happens to a robot in them: its wheels spin while it stands, or it is carried off."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.se2 import Array
from moteslam.robot.values import Angle, Number, Section
from moteslam.sim.robot.driver import MAX_DURATION, SPACING, Commands, Driver, Route, Seconds, Task, sampled
from moteslam.sim.world.world import World, check_place

FAR = 10.0  # How far along its path a robot is carried unless it is said [m]
CORNER = 0.3  # Over which corners are rounded, before and after them [m]
TURNS = 0.4  # Over which turns are smoothed, before and after them [s]

Duration = Annotated[Number, Field(gt=0, le=MAX_DURATION)]


class Interval(Section):
    """A part of a drive: from ``start`` after its first moment [s], for ``duration`` [s] or to its end."""

    start: Seconds = 0.0
    duration: Duration | None = None

    @property
    def end(self) -> float:
        """When it ends [s], infinite where it lasts to the drive's end."""
        return math.inf if self.duration is None else self.start + self.duration

    def covers(self, times: Array) -> NDArray[np.bool_]:
        """Which times [...] since the drive's first moment [s] are in it, its start but not its end."""
        return np.asarray((times >= self.start) & (times < self.end))


class Spell(Interval):
    """An interval of which both must be said."""

    start: Seconds
    duration: Duration


class StuckWheels(Spell):
    """The robot stands against a step while its wheels spin at the speed that the driver asks for."""

    kind: Literal["stuck_wheels"] = "stuck_wheels"


class Carried(Interval):
    """The robot is lifted, carried along its path, set down elsewhere, and goes on with its task from there.

    Its wheels do not turn meanwhile; its gyro measures how it is turned, to where it is carried.
    """

    kind: Literal["carried"] = "carried"
    start: Seconds
    duration: Annotated[Number, Field(ge=1, le=600)] = 15.0
    # where it is set down: x, y [m], heading [rad]; it goes on from the nearest place of its path
    to: tuple[Number, Number, Angle] | None = None
    # in place of that: how far along its path, negative for back [m]. Without either it is 10 m, ahead where the path
    # is that long, else back
    along: Annotated[Number, Field(ge=-10_000, le=10_000)] | None = None
    lidar: Literal["on", "off"] = "on"  # whether scans are recorded meanwhile

    @model_validator(mode="after")
    def _goes_to_one_place(self) -> Self:
        if self.to is not None and self.along is not None:
            raise ValueError("both to and along, expected one of them at most")
        return self


Mishap = StuckWheels | Carried


def check_mishaps(faults: Sequence[object], task: Task, world: World, platform: Platform) -> None:
    """Refuse mishaps at the same time, and places to set the robot down at that are not free or off its path."""
    end = 0.0
    for start, i in sorted((fault.start, i) for i, fault in enumerate(faults) if isinstance(fault, Mishap)):
        fault, field = faults[i], f"faults.{i}"
        assert isinstance(fault, Mishap)
        if start < end:
            raise ConfigError(
                f"{start:g} s, expected after the end of the one before, {end:g} s", field=f"{field}.start"
            )
        end = fault.end
        if not isinstance(fault, Carried):
            continue
        if fault.to is None:
            if isinstance(task, Commands):
                raise ConfigError("missing, expected where a robot with commands is set down", field=f"{field}.to")
            continue
        place = np.array(fault.to[:2])
        check_place(world, place, platform.radius, field=f"{field}.to", what="the robot")
        if isinstance(task, Route):
            points, _ = sampled(task.path())
            nearest = points[np.argmin(np.hypot(*(points - place).T))]
            samples = np.linspace(place, nearest, 2 + int(np.hypot(*(nearest - place)) / SPACING))
            if not world.is_free(samples, platform.width / 2).all():
                raise ConfigError(
                    f"a wall between ({place[0]:g}, {place[1]:g}) and the route, expected a free line between them",
                    field=f"{field}.to",
                )


def carrying(fault: Carried, pose: Array, driver: Driver | None, rate: int, *, field: str) -> tuple[Array, int]:
    """How the robot is carried from a pose [3], the heading not wrapped, along the path of its driver, at a rate [Hz].

    At the speed of one who starts and stops, facing where it is carried; without a driver straight there. Poses [n, 3],
    the last where it is set down, and the index on the driver's path from which it goes on, 0 where it has none.
    """
    points, at = (None, 0) if driver is None else (driver.path, driver.at)
    if points is None:
        assert fault.to is not None  # a scenario without is refused
        corners, goal, target = np.array((pose[:2], fault.to[:2])), 0, np.array(fault.to)
    else:
        headings = np.arctan2(*np.gradient(points, axis=0).T[::-1])
        if fault.to is None:
            goal = _along(fault.along, at, len(points) - 1, field)
            target = np.append(points[goal], headings[goal])
        else:
            target = np.array(fault.to)
            # of places alike the one that leads on in the same direction, and of laps the nearest
            away = np.hypot(*(points - target[:2]).T) + 0.1 * np.abs(se2.wrap(headings - target[2]))
            goal = int(np.argmin(away + 1e-3 * SPACING * np.abs(np.arange(len(points)) - at)))
        between = points[at : goal + 1] if goal >= at else points[goal : at + 1][::-1]
        corners = np.concatenate((pose[None, :2], between, target[None, :2]))
    return _walked(corners, pose[2], target, max(1, round(fault.duration * rate)), rate), goal


def _along(along: float | None, at: int, last: int, field: str) -> int:
    """The index on a path [last + 1] so far along [m] from another."""
    if along is None:
        return at + min(round(FAR / SPACING), last - at) if last - at >= at else max(at - round(FAR / SPACING), 0)
    goal = at + round(along / SPACING)
    if not 0 <= goal <= last:
        left, which = (last - at, "left") if along > 0 else (at, "behind")
        raise ConfigError(
            f"{along:g} m of a path of which {left * SPACING:.1f} m are {which}, expected at most this distance",
            field=f"{field}.along",
        )
    return goal


def _walked(corners: Array, heading: float, target: Array, count: int, rate: int) -> Array:
    """The poses [count, 3] of one carried from corner to corner [k, 2], facing where it is carried but at both ends."""
    distinct = np.append(True, np.hypot(*np.diff(corners, axis=0).T) > 1e-9)
    share = np.arange(1, count + 1) / count
    poses = np.empty((count, 3))
    if distinct.sum() < 2:
        poses[:, :2], facing = corners[0], np.full(count, heading)
    else:
        points, length = sampled(corners[distinct])
        points = _smoothed(points, round(CORNER / SPACING))
        directions = np.unwrap(np.arctan2(*np.gradient(points, axis=0).T[::-1]))
        walked = length[-1] * _eased(share)
        poses[:, :2] = np.stack([np.interp(walked, length, axis) for axis in points.T], axis=-1)
        facing = np.interp(walked, length, directions)
        facing += math.tau * round((heading - facing[0]) / math.tau)
    last = target[2] + math.tau * round((facing[-1] - target[2]) / math.tau)
    begun, ending = _eased(share / 0.2), _eased((share - 0.8) / 0.2)
    facing = heading + (facing - heading) * begun + (last - facing) * ending
    poses[:, 2] = _smoothed(facing, round(TURNS * rate))
    poses[-1] = *target[:2], last
    return poses


def _eased(share: Array) -> Array:
    """From 0 to 1 as the share does, slowly at both ends."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share**2 * (3 - 2 * share))


def _smoothed(values: Array, half: int) -> Array:
    """The mean of each value [n, ...] and at most ``half`` of those on either side; the ends stay where they are."""
    half = min(half, len(values) - 1)
    before, after = 2 * values[:1] - values[half:0:-1], 2 * values[-1:] - values[-2 : -half - 2 : -1]
    total = np.cumsum(np.concatenate((np.zeros_like(values[:1]), before, values, after)), axis=0)
    return np.asarray((total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1))
