"""What a scenario's parts must be to each other; each of them alone is checked where it is defined."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import ConfigError
from moteslam.sim.camera import check_mount
from moteslam.sim.driving import sideways_ratio
from moteslam.sim.rates import BEAMS, LIDAR_RATE, PHYSICS_RATE
from moteslam.sim.world import World

if TYPE_CHECKING:
    from moteslam.sim.scenario import Scenario

MAX_SEGMENTS = 20_000
"""Line segments in a world that a file spells out."""

MAX_PLAN_SEGMENTS = 400_000
"""Line segments in a world with a floor plan."""

MAX_REACH = 2.0
"""Of a sensor's mount from the robot's centre [m]."""

_SAMPLING = 0.05
"""Between the points at which a leg is looked at [m]."""


def check_scenario(scenario: Scenario) -> None:
    """Refuse a scenario that contradicts itself.

    Raises:
        ConfigError: not exactly one thing to do, a platform that cannot drive, a camera that cannot record, rests
            longer than the run, an empty or outsized world, a floor plan or picture that cannot be read, people
            who begin on each other or the robot, a door shut across its start, or a robot, waypoint or leg that
            touches a wall.
    """
    _check_task(scenario)
    _check_platform(scenario)
    _check_body(scenario)
    if scenario.camera is not None:
        check_mount(scenario.platform.camera)
    if scenario.floor is not None:
        scenario.floor.check_picture()
    world = _world(scenario)
    if not len(world.segments):
        raise ConfigError("nothing stands in it, expected a wall, room, box, pillar, furniture or plan", field="world")
    most = MAX_SEGMENTS if scenario.world.plan is None else MAX_PLAN_SEGMENTS
    if len(world.segments) > most:
        raise ConfigError(f"{len(world.segments)} segments, expected at most {most}", field="world")
    _check_people(scenario, world)
    _check_doors(scenario)
    start = scenario.start[:2]
    if scenario.commands is not None:
        _check_place(world, start, scenario.radius, "commands.start", "the robot starts")
    elif scenario.wander is not None:
        _check_place(world, start, scenario.radius, "wander.start", "the robot starts")
    else:
        _check_route(scenario, world)


def _world(scenario: Scenario) -> World:
    """What stands in it; whatever is wrong with its floor plan is told of the key that names the plan."""
    try:
        return World.of(scenario.world)
    except ConfigError as error:
        raise ConfigError(str(error), field="world.plan.file") from error


def _check_task(scenario: Scenario) -> None:
    tasks = ("route", "wander", "commands")
    given = [task for task in tasks if getattr(scenario, task) is not None]
    if len(given) != 1:
        found = " and ".join(given) if given else "nothing to do"
        raise ConfigError(
            f"{found}, expected exactly one of route, wander and commands", field=given[-1] if given else "route"
        )
    rests = scenario.drive.rest_start + scenario.drive.rest_end
    if scenario.duration <= rests:
        raise ConfigError(
            f"{scenario.duration:g} s, expected more than the rests at start and end, {rests:g} s", field="duration"
        )
    way = scenario.wander.distance if scenario.wander is not None else 0.0
    if scenario.route is not None:
        way = float(np.hypot(*np.diff(scenario.route.path(), axis=0).T).sum())
    needed = rests + way / scenario.drive.speed
    if scenario.duration < needed:
        raise ConfigError(
            f"{scenario.duration:g} s, expected at least the {needed:.0f} s that {way:.0f} m at "
            f"{scenario.drive.speed:g} m/s and the rests take",
            field="duration",
        )


def _check_platform(scenario: Scenario) -> None:
    platform, wheels = scenario.platform, scenario.platform.wheels
    if wheels is None:
        raise ConfigError("none, expected wheels to drive on", field="platform.wheels")
    if wheels.effective_track < wheels.track:
        raise ConfigError(
            f"{wheels.effective_track:g} m, expected at least the track, {wheels.track:g} m",
            field="platform.wheels.effective_track",
        )
    for side, inner, outer in (("length", wheels.wheel_base, platform.length), ("width", wheels.track, platform.width)):
        if inner > outer:
            raise ConfigError(
                f"{outer:g} m, expected the wheels, {inner:g} m apart, within the body", field=f"platform.{side}"
            )

    for sensor, mount in (("lidar", platform.lidar), ("camera", platform.camera)):
        if mount is not None and (away := float(np.hypot(mount.x, mount.y))) > MAX_REACH:
            axis = "x" if abs(mount.x) >= abs(mount.y) else "y"
            raise ConfigError(
                f"{away:g} m from the robot's centre, expected at most {MAX_REACH:g} m",
                field=f"platform.{sensor}.{axis}",
            )

    sweep = platform.lidar.time_increment * (BEAMS - 1)
    if sweep > 1 / LIDAR_RATE:
        raise ConfigError(
            f"{BEAMS} beams take {sweep:g} s, expected at most the {1 / LIDAR_RATE:g} s between two scans",
            field="platform.lidar.time_increment",
        )


def _check_body(scenario: Scenario) -> None:
    """Refuse a contact so stiff, for masses so small, that a step of the physics overshoots by more than half."""
    body, platform, wheels = scenario.body, scenario.platform, scenario.platform.wheels
    assert wheels is not None
    ratio = sideways_ratio(wheels)
    inertia = body.mass * (platform.length**2 + platform.width**2) / 12
    arm = ratio * wheels.wheel_base**2 + wheels.track**2  # four wheels, half a base and half a track away
    softest = min(body.wheel_mass, body.mass / 4 / max(ratio, 1.0), inertia / arm)
    stiffest = softest * PHYSICS_RATE / 2
    if body.stiffness > stiffest:
        raise ConfigError(
            f"{body.stiffness:g} N s/m, expected at most {stiffest:.3g} for these masses and this effective track",
            field="body.stiffness",
        )


def _check_route(scenario: Scenario, world: World) -> None:
    assert scenario.route is not None
    for i, point in enumerate(scenario.route.waypoints):
        what = "the robot starts" if i == 0 else "the waypoint is"
        _check_place(world, point, scenario.radius, f"route.waypoints.{i}", what)
    _check_legs(world, scenario.route.corners, scenario.platform.width / 2, "route.waypoints")


def _check_people(scenario: Scenario, world: World) -> None:
    for i, person in enumerate(scenario.people):
        places = np.asarray(person.waypoints)
        for j, place in enumerate(places):
            _check_place(world, place, person.radius, f"people.{i}.waypoints.{j}", "the person is")
        _check_legs(world, places, person.radius, f"people.{i}.waypoints")
        if np.hypot(*(places[0] - scenario.start[:2])) < person.radius + scenario.radius:
            raise ConfigError(
                "the person begins where the robot starts, expected them apart", field=f"people.{i}.waypoints.0"
            )
        for j, other in enumerate(scenario.people[:i]):
            if np.hypot(*(places[0] - other.waypoints[0])) < person.radius + other.radius:
                raise ConfigError(
                    f"the person begins where people.{j} does, expected them apart", field=f"people.{i}.waypoints.0"
                )


def _check_doors(scenario: Scenario) -> None:
    known = scenario.world.palette
    for i, door in enumerate(scenario.doors):
        if door.material not in known:
            raise ConfigError(f"{door.material!r}, expected one of {', '.join(known)}", field=f"doors.{i}.material")
        leaf = World(np.array([(*door.hinge, *door.end)]))
        away = float(leaf.distance(scenario.start[:2])[0])
        if away < scenario.radius:
            raise ConfigError(
                f"the shut leaf is {away:.2f} m from where the robot starts, expected at least {scenario.radius:.2f} m",
                field=f"doors.{i}",
            )


def _check_legs(world: World, corners: NDArray[np.float64], beside: float, field: str) -> None:
    """Refuse legs between waypoints that do not keep clear of the walls."""
    for i, (a, b) in enumerate(pairwise(corners)):
        samples = np.linspace(a, b, max(2, int(np.ceil(np.hypot(*(b - a)) / _SAMPLING)) + 1))
        free = world.is_free(samples, beside)
        if not free.all():
            x, y = samples[np.argmin(free)]
            raise ConfigError(
                f"the leg to the next waypoint runs into a wall near ({x:.2f}, {y:.2f}), "
                f"expected {beside:.2f} m clear on both sides",
                field=f"{field}.{i}",
            )


def _check_place(world: World, point: ArrayLike, radius: float, field: str, what: str) -> None:
    x, y = np.asarray(point, np.float64)
    if world.inside_solid(point)[0]:
        raise ConfigError(f"{what} inside a wall at ({x:g}, {y:g}), expected free space", field=field)
    away = float(world.distance(point)[0])
    if away < radius:
        raise ConfigError(
            f"{what} {away:.2f} m from a wall at ({x:g}, {y:g}), expected at least {radius:.2f} m", field=field
        )
