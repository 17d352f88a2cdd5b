"""Hypotheses: particles that look for the robot at different places, after a search that found several."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.registration.localisation import APART, Rivals
from moteslam.slam.tsdf.particles import Particles

Array = NDArray[np.float64]

OPEN = 0.001
"""Weight of the particles of other hypotheses than the best one's from which on it is open where the robot is."""


def settled(particles: Particles) -> bool:
    """Whether next to no weight is on particles of another hypothesis than the best one's."""
    others = particles.hypotheses != particles.hypotheses[particles.best]
    return bool(particles.weights.values[others].sum() < OPEN)


def join(particles: Particles) -> None:
    """Particles that have come to where the best one is are of its hypothesis."""
    if (particles.hypotheses == particles.hypotheses[particles.best]).all():
        return
    together = (np.abs(particles.offsets()) < APART).all(axis=1)
    particles.hypotheses[together] = particles.hypotheses[particles.best]


def divide(particles: Particles, rivals: Rivals, evidence_share: float) -> Array:
    """Divide the particles around the best one among rival places by their odds; the best one stays.

    A place where a particle is already is left out.

    Args:
        evidence_share: share of the match score that counts in the odds.

    Returns:
        [N, 3] where each looks for the robot, from where the tracked motion leads it.
    """
    places = np.zeros((len(particles), 3))
    if not len(rivals.offsets):
        return places
    off = particles.offsets()
    away = off[:, None] - rivals.offsets
    away[..., 2] = se2.wrap(away[..., 2])
    free = (np.abs(away) >= APART).any(axis=2).all(axis=0)
    if not free.any():
        return places
    mode = np.flatnonzero((np.abs(off) < APART).all(axis=1))
    mode = np.append(particles.best, mode[mode != particles.best])
    odds = np.append(0.0, rivals.log_odds(evidence_share)[free])
    shares = np.exp(odds - odds.max())
    chosen = np.searchsorted(np.cumsum(shares) / shares.sum(), (np.arange(len(mode)) + 0.5) / len(mode))
    chosen[0] = 0
    places[mode] = np.vstack((np.zeros(3), rivals.offsets[free]))[chosen]
    sent = mode[chosen > 0]
    particles.hypotheses[sent] = particles.hypotheses.max() + chosen[chosen > 0]
    return places
