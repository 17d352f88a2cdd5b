"""Several hypotheses of where the robot is: particles at each place that a search could not tell apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.registration.localisation import APART, Rivals
from moteslam.slam.tsdf.particles import Particles

Array = NDArray[np.float64]

OPEN = 0.01
"""Weight of the particles away from the best one from which on it is open where the robot is."""


def settled(particles: Particles) -> bool:
    """Whether next to no weight is on particles at another place than the best one's."""
    away = (np.abs(particles.offsets()) >= APART).any(axis=1)
    return bool(particles.weights.values[away].sum() < OPEN)


def places(particles: Particles, rivals: Rivals) -> Array:
    """Where each particle looks for the robot, from where the tracked motion leads it [N, 3].

    The particles around the best one are divided among the places by their odds, but for places where a particle is
    already; the best one stays.

    Args:
        particles: N of them.
        rivals: places as likely as the tracked one, from there.
    """
    found, off = np.zeros((len(particles), 3)), particles.offsets()
    free = (np.abs(off[:, None] - rivals.offsets) >= APART).any(axis=2).all(axis=0)
    if not free.any():
        return found
    mode = np.flatnonzero((np.abs(off) < APART).all(axis=1))
    mode = np.append(particles.best, mode[mode != particles.best])
    odds = np.append(0.0, rivals.log_odds[free])
    shares = np.exp(odds - odds.max())
    chosen = np.searchsorted(np.cumsum(shares) / shares.sum(), (np.arange(len(mode)) + 0.5) / len(mode))
    chosen[0] = 0
    found[mode] = np.vstack((np.zeros(3), rivals.offsets[free]))[chosen]
    return found
