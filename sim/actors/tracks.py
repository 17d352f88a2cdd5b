"""Tracks: where people and doors were, as the lidar sees them: discs and lines at 100 Hz, straight in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.values import Summarised
from moteslam.sim.actors.people import Person

TRUTH_RATE = 100
"""Places of people and doors, and true poses of the robot, that are kept a second [Hz]."""
STEP_LENGTH = 0.7
"""Of a walking person: from one footprint to the next [m]."""
STRIDE = 0.18
"""How far a leg swings forward and back, at the lidar's height [m]."""
LEGS_APART = 0.11
"""Of each leg from the middle [m]."""


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Summarised):
    """Discs (legs, bodies) and lines (doors' leaves) at ``rate`` a second from the drive's first moment on.

    Between two samples everything is taken to move straight: at 2 m/s^2 that is off by 25 micrometres.

    Attributes:
        rate: [Hz].
        discs: float32 [t, k, 3] x, y, radius [m].
        lines: float32 [t, m, 4] x0, y0, x1, y1 [m].
        surfaces: int16 [m] what the lines are made of, as in the world's palette.
        people: float64 [t, p, 2] the people's centres [m].
    """

    rate: float
    discs: NDArray[np.float32]
    lines: NDArray[np.float32]
    surfaces: NDArray[np.int16]
    people: NDArray[np.float64]


def tracks_of(
    persons: tuple[Person, ...], places: NDArray[np.float64], leaves: NDArray[np.float64], surfaces: list[int]
) -> Tracks:
    """The discs and lines from what the physics engine recorded.

    Args:
        persons: the people.
        places: [t, p, 2] the people's centres at `TRUTH_RATE` [m].
        leaves: [t, m, 4] the doors' leaves [m].
        surfaces: [m] of the leaves.
    """
    discs = [np.empty((len(places), 0, 3))]
    for i, person in enumerate(persons):
        if person.legs:
            discs.append(_legs(places[:, i], person.leg))
        else:
            radius = np.full((len(places), 1), person.radius)
            discs.append(np.concatenate((places[:, i], radius), axis=1)[:, None])
    return Tracks(
        float(TRUTH_RATE),
        np.ascontiguousarray(np.concatenate(discs, axis=1), np.float32),
        np.ascontiguousarray(leaves, np.float32),
        np.asarray(surfaces, np.int16),
        places,
    )


def _legs(path: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Two legs [t, 2, 3] that swing in turns with the distance walked, side by side while standing."""
    from scipy.ndimage import uniform_filter1d

    velocity = uniform_filter1d(np.gradient(path, axis=0) * TRUTH_RATE, max(1, TRUTH_RATE // 2), axis=0, mode="nearest")
    speed = np.hypot(*velocity.T)
    walking = speed > 0.1
    last = np.maximum.accumulate(np.where(walking, np.arange(len(path)), 0))
    heading = np.arctan2(velocity[last, 1], velocity[last, 0])
    walked = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    swing = STRIDE * np.minimum(speed / 0.6, 1.0) * np.sin(np.pi * walked / STEP_LENGTH)
    ahead = np.stack((np.cos(heading), np.sin(heading)), axis=-1)
    left = np.stack((-ahead[:, 1], ahead[:, 0]), axis=-1)
    legs = [path + side * (LEGS_APART * left + swing[:, None] * ahead) for side in (1.0, -1.0)]
    return np.concatenate((np.stack(legs, axis=1), np.full((len(path), 2, 1), radius)), axis=-1)
