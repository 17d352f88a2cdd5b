"""A random route of straight legs through free space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.sim.driving import Wander
from moteslam.sim.world import World

_TRIES = 2000


def wander_path(wander: Wander, world: World, rng: np.random.Generator) -> NDArray[np.float64]:
    """The corners [k, 2] [m] of a route of at least ``wander.distance``.

    Each leg leads in a random direction, turning back only where nothing else is free.

    Raises:
        ConfigError: no free leg leads on from where the route has come to.
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
