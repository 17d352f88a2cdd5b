"""Checks that a scenario's world is one, and that places and paths in it keep clear of the walls."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import ConfigError
from moteslam.sim.world.world import World

MAX_SEGMENTS = 20_000
"""Line segments in a world that a file spells out."""

MAX_PLAN_SEGMENTS = 400_000
"""Line segments in a world with a floor plan."""

_SAMPLING = 0.05
"""Between the points of a leg that are checked [m]."""


def check_world(world: World) -> None:
    """Refuse a world that is empty or too large.

    Raises:
        ConfigError: so it is.
    """
    if not len(world.segments):
        raise ConfigError("nothing stands in it, expected a wall, room, box, pillar, furniture or plan", field="world")
    limit = MAX_SEGMENTS if world.plan is None else MAX_PLAN_SEGMENTS
    if len(world.segments) > limit:
        raise ConfigError(f"{len(world.segments)} segments, expected at most {limit}", field="world")


def check_place(world: World, point: ArrayLike, radius: float, *, field: str, what: str) -> None:
    """Refuse a place in a wall or nearer to one than ``radius`` [m].

    Args:
        world: what stands there.
        point: [2] [m].
        radius: of what is to be there [m].
        field: of the scenario that names the place.
        what: is to be there, with its verb (``the robot starts``).

    Raises:
        ConfigError: the place is not free.
    """
    x, y = np.asarray(point, np.float64)
    if world.inside_solid(point)[0]:
        raise ConfigError(f"{what} inside a wall at ({x:g}, {y:g}), expected free space", field=field)
    away = float(world.distance(point)[0])
    if away < radius:
        raise ConfigError(
            f"{what} {away:.2f} m from a wall at ({x:g}, {y:g}), expected at least {radius:.2f} m", field=field
        )


def check_legs(world: World, corners: NDArray[np.float64], clearance: float, *, field: str) -> None:
    """Refuse straight legs between waypoints that do not keep clear of the walls.

    Args:
        world: what stands there.
        corners: [k, 2] the waypoints [m].
        clearance: free space on both sides [m].
        field: of the scenario that lists the waypoints; the index of the leg is appended.

    Raises:
        ConfigError: a leg that runs into a wall.
    """
    for i, (a, b) in enumerate(pairwise(corners)):
        samples = np.linspace(a, b, max(2, int(np.ceil(np.hypot(*(b - a)) / _SAMPLING)) + 1))
        free = world.is_free(samples, clearance)
        if not free.all():
            x, y = samples[np.argmin(free)]
            raise ConfigError(
                f"the leg to the next waypoint runs into a wall near ({x:.2f}, {y:.2f}), "
                f"expected {clearance:.2f} m clear on both sides",
                field=f"{field}.{i}",
            )
