"""Checks that people and doors can be where a scenario puts them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.sim.actors.doors import Door
from moteslam.sim.actors.people import Person
from moteslam.sim.world.clearance import check_legs, check_place
from moteslam.sim.world.world import World


def check_people(people: Sequence[Person], world: World, start: NDArray[np.float64], radius: float) -> None:
    """Refuse people who walk into walls, or begin on each other or on the robot.

    Args:
        people: those with waypoints.
        world: what stands there.
        start: [2] the robot's [m].
        radius: of the robot [m].

    Raises:
        ConfigError: the first of them; its place in the scenario is named.
    """
    for i, person in enumerate(people):
        places = np.asarray(person.waypoints)
        for j, place in enumerate(places):
            check_place(world, place, person.radius, field=f"people.{i}.waypoints.{j}", what="the person is")
        check_legs(world, places, person.radius, field=f"people.{i}.waypoints")
        if np.hypot(*(places[0] - start)) < person.radius + radius:
            raise ConfigError(
                "the person begins where the robot starts, expected them apart", field=f"people.{i}.waypoints.0"
            )
        for j, other in enumerate(people[:i]):
            if np.hypot(*(places[0] - other.waypoints[0])) < person.radius + other.radius:
                raise ConfigError(
                    f"the person begins where people.{j} does, expected them apart", field=f"people.{i}.waypoints.0"
                )


def check_doors(doors: Sequence[Door], world: World, start: NDArray[np.float64], radius: float) -> None:
    """Refuse doors of an unknown material, or shut across the robot's start.

    Args:
        doors: all of them.
        world: whose materials are known.
        start: [2] the robot's [m].
        radius: of the robot [m].

    Raises:
        ConfigError: the first of them; its place in the scenario is named.
    """
    for i, door in enumerate(doors):
        if door.material not in world.palette:
            raise ConfigError(
                f"{door.material!r}, expected one of {', '.join(world.palette)}", field=f"doors.{i}.material"
            )
        leaf = World(np.array([(*door.hinge, *door.end)]))
        away = float(leaf.distance(start)[0])
        if away < radius:
            raise ConfigError(
                f"the shut leaf is {away:.2f} m from where the robot starts, expected at least {radius:.2f} m",
                field=f"doors.{i}",
            )
