"""How many particles survive, and which: KLD sampling (Fox 2003; Probabilistic Robotics, section 8.3.4)."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.filter.config import KldConfig
from moteslam.slam.filter.resampling import Draws, generator_for, resample


class ResamplingConfig(Protocol):
    """What resampling needs of a filter's configuration."""

    @property
    def particles(self) -> int:
        """The largest number of particles."""

    @property
    def resampling(self) -> str:
        """One of ``SCHEMES``."""

    @property
    def kld(self) -> KldConfig:
        """Whether and how the number is adapted."""


def enough_particles(bins: NDArray[np.int64], epsilon: float, delta: float) -> NDArray[np.float64]:
    """The number of samples with which a histogram is, with a probability, near to what it was drawn from.

    Probabilistic Robotics, table 8.4, line 16: the Wilson-Hilferty approximation of a chi-square quantile.

    Args:
        bins: k >= 1 bins that have a sample in them; any shape.
        epsilon: the Kullback-Leibler distance that is allowed.
        delta: the probability that it is exceeded.

    Returns:
        float64 of the shape of ``bins``; 0 for one bin.
    """
    from statistics import NormalDist  # 2 ms of every start, and only a number of particles that varies needs it

    degrees = np.maximum(np.asarray(bins, np.float64) - 1, 0)
    ninth = 2 / (9 * np.maximum(degrees, 1))
    quantile = degrees * (1 - ninth + np.sqrt(ninth) * NormalDist().inv_cdf(1 - delta)) ** 3
    return np.asarray(quantile / (2 * epsilon))


def particle_number(
    poses: NDArray[np.float64], weights: NDArray[np.float64], config: KldConfig, most: int, *, seed: int, step: int
) -> int:
    """The number of particles to resample to: poses are drawn until the bins they fall in ask for no more.

    Table 8.4 of Probabilistic Robotics, with the particles as they are before resampling for the proposal; what it
    adds to them within a step is small against a bin.

    Args:
        poses: [N, 3] of the particles.
        weights: [N], sum 1.
        config: the bins and the bound.
        most: particles.
        seed, step: of the draws.

    Returns:
        from ``config.least`` to ``most``, which wins.
    """
    generator = generator_for(seed, step, Draws.NUMBER)
    cumulative = np.cumsum(weights)
    drawn = np.searchsorted(cumulative / cumulative[-1], generator.random(most), side="right")
    drawn = np.minimum(drawn, len(weights) - 1)
    # the first pose is the middle of a bin, so that a posterior narrower than a bin lies in one, wherever it is
    offsets = poses[drawn] - poses[drawn[0]]
    offsets[:, 2] = se2.wrap(offsets[:, 2])
    cells = np.rint(offsets / (config.bin_size, config.bin_size, config.bin_angle)).astype(np.int64)
    new = np.zeros(most, np.int64)
    new[np.unique(cells, axis=0, return_index=True)[1]] = 1
    enough = np.maximum(enough_particles(np.cumsum(new), config.epsilon, config.delta), config.least)
    stop = np.flatnonzero(np.arange(1, most + 1) >= enough)
    return int(stop[0]) + 1 if len(stop) else most


def choose_parents(
    config: ResamplingConfig, poses: NDArray[np.float64], weights: NDArray[np.float64], *, seed: int, step: int
) -> NDArray[np.int64]:
    """The particles that survive, [M] rising indices: as many as there are, or as ``config.kld`` asks for.

    Args:
        config: scheme and bounds.
        poses: [N, 3] of the particles as weighed.
        weights: [N], sum 1.
        seed, step: of the draws.
    """
    count = len(poses)
    if config.kld.enabled:
        count = particle_number(poses, weights, config.kld, config.particles, seed=seed, step=step)
    return resample(config.resampling, weights, generator_for(seed, step), count)
