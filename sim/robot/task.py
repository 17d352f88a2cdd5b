"""What the robot is asked to do: follow a route, wander, or obey commands; the driver for it, and its checks."""

from __future__ import annotations

import numpy as np

from moteslam.errors import ConfigError
from moteslam.robot.platform import Platform
from moteslam.sim.robot.commands import BlindDriver, Commands
from moteslam.sim.robot.driver import Driver
from moteslam.sim.robot.limits import Limits
from moteslam.sim.robot.pursuit import PathDriver
from moteslam.sim.robot.route import Route
from moteslam.sim.robot.wander import Wander, wander_path
from moteslam.sim.world.clearance import check_legs, check_place
from moteslam.sim.world.world import World

Task = Route | Wander | Commands


def driver_for(task: Task, limits: Limits, world: World, rng: np.random.Generator) -> Driver:
    """The driver that does a task.

    Args:
        task: to do.
        limits: to drive within.
        world: to drive in.
        rng: of the driver's inattention and, for a wander, of its path.

    Raises:
        ConfigError: a wander that finds no free leg.
    """
    match task:
        case Commands():
            return BlindDriver(task)
        case Route():
            return PathDriver(task.path(), limits, rng)
        case Wander():
            return PathDriver(wander_path(task, world, rng), limits, rng)


def check_duration(task: Task, limits: Limits, duration: float) -> None:
    """Refuse a run [s] that is too short for its rests and its task.

    Raises:
        ConfigError: so it is.
    """
    rests = limits.rest_start + limits.rest_end
    if duration <= rests:
        raise ConfigError(
            f"{duration:g} s, expected more than the rests at start and end, {rests:g} s", field="duration"
        )
    distance = 0.0
    if isinstance(task, Route):
        distance = float(np.hypot(*np.diff(task.path(), axis=0).T).sum())
    elif isinstance(task, Wander):
        distance = task.distance
    needed = rests + distance / limits.speed
    if duration < needed:
        raise ConfigError(
            f"{duration:g} s, expected at least the {needed:.0f} s that {distance:.0f} m at "
            f"{limits.speed:g} m/s and the rests take",
            field="duration",
        )


def check_task(task: Task, world: World, platform: Platform) -> None:
    """Refuse a start, waypoint or leg in a wall, or too near to one for the robot.

    Raises:
        ConfigError: the first of them; its place in the scenario is named.
    """
    match task:
        case Route():
            for i, point in enumerate(task.waypoints):
                what = "the robot starts" if i == 0 else "the waypoint is"
                check_place(world, point, platform.radius, field=f"route.waypoints.{i}", what=what)
            check_legs(world, task.corners, platform.width / 2, field="route.waypoints")
        case Wander():
            check_place(world, task.start, platform.radius, field="wander.start", what="the robot starts")
        case Commands():
            check_place(world, task.start[:2], platform.radius, field="commands.start", what="the robot starts")
