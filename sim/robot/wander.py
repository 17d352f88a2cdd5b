"""A wander: a random path of straight legs through free space."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.tables import Number, Positive, Section
from moteslam.sim.world.geometry import Point
from moteslam.sim.world.world import World

_TRIES = 2000


class Wander(Section):
    """A path of straight legs between places chosen at random (by the seed) in view of each other.

    Attributes:
        start: where the robot starts [m].
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

    Raises:
        ConfigError: no free leg leads on from the end of the path.
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
