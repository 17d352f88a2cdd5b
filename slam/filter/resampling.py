"""Resampling: indices of particles drawn in proportion to their weights, by one of three schemes."""

from collections.abc import Callable
from enum import IntEnum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.robot.values import Number, Positive, Section, Truth, Whole

Parents = NDArray[np.int64]


class KldConfig(Section):
    """KLD sampling: as many particles as the posterior needs (Fox 2003; Probabilistic Robotics, table 8.4).

    The number changes where particles are resampled, and there alone.
    """

    enabled: Truth = False  # Adapt the number of particles; `particles` is then the largest number, and the first
    epsilon: Positive = 0.05  # Kullback-Leibler distance that is allowed between particles and posterior, over the bins
    delta: Annotated[Number, Field(gt=0, lt=1)] = 0.01  # Probability that it is exceeded
    bin_size: Positive = 0.1  # Of the bins in x and in y [m]
    bin_angle: Positive = 0.05  # Of the bins in the heading [rad]
    least: Annotated[Whole, Field(ge=1)] = 10  # Never fewer particles than these; `particles` wins if it is smaller


def systematic(weights: Array, generator: np.random.Generator, count: int) -> Parents:
    """Low-variance resampling with one random number (Probabilistic Robotics, table 4.4).

    A particle of weight w is drawn floor(M w) or ceil(M w) times.
    """
    return _at((np.arange(count) + generator.random()) / count, weights)


def stratified(weights: Array, generator: np.random.Generator, count: int) -> Parents:
    """One number drawn in each of M equal strata (Kitagawa 1996).

    Unlike the numbers of ``systematic`` they are independent; a particle of weight w is drawn less than 2 times off
    M w.
    """
    return _at((np.arange(count) + generator.random(count)) / count, weights)


def residual(weights: Array, generator: np.random.Generator, count: int) -> Parents:
    """floor(M w) times for certain, the rest drawn independently from what the floors leave (Liu and Chen 1998)."""
    expected = count * weights / weights.sum()
    # equal weights must not lose one of their copies to rounding
    certain = np.floor(expected + 1e-9).astype(np.int64)
    copies = np.repeat(np.arange(len(weights)), certain)[:count]
    left = count - len(copies)
    if left:
        rest = np.maximum(expected - certain, 0.0)
        copies = np.sort(np.concatenate((copies, _at(generator.random(left), rest))))
    return copies.astype(np.int64)


SCHEMES: dict[str, Callable[[Array, np.random.Generator, int], Parents]] = {
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
}
"""What the configuration key ``resampling`` names: draw so many particles M in proportion to their weights [N], not all
0. One of weight w is drawn M w times on average, one of weight 0 never. Rising indices [M]."""


class Draws(IntEnum):
    """Purposes of random numbers; each has a stream of its own in every step."""

    RESAMPLING = 0
    PROPOSAL = 1
    NUMBER = 3


def generator_for(seed: int, step: int, purpose: Draws = Draws.RESAMPLING) -> np.random.Generator:
    """The host's random numbers of one step and purpose: keyed on (seed, step), independent of any step before it."""
    key = np.array([seed, step], np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=np.array([0, 0, 0, purpose], np.uint64)))


def _at(positions: NDArray[np.float64], weights: Array) -> Parents:
    """The particles whose share of the interval from 0 to 1 has these positions in it, [M]."""
    cumulative = np.cumsum(weights)
    last = int(np.searchsorted(cumulative, cumulative[-1]))  # those after it weigh nothing
    found = np.searchsorted(cumulative / cumulative[-1], positions, side="right")
    return np.minimum(found, last).astype(np.int64)


def enough_particles(bins: NDArray[np.int64], epsilon: float, delta: float) -> NDArray[np.float64]:
    """The number of samples, of k >= 1 bins that have one, by which a histogram is probably near to what it was drawn
    from.

    Probabilistic Robotics, table 8.4, line 16: the Wilson-Hilferty approximation of a chi-square quantile. Of the shape
    of ``bins``; 0 for one bin.
    """
    from statistics import NormalDist  # 2 ms of every start, and only a number of particles that varies needs it

    degrees = np.maximum(np.asarray(bins, np.float64) - 1, 0)
    ninth = 2 / (9 * np.maximum(degrees, 1))
    quantile = degrees * (1 - ninth + np.sqrt(ninth) * NormalDist().inv_cdf(1 - delta)) ** 3
    return np.asarray(quantile / (2 * epsilon))


def particle_number(
    poses: NDArray[np.float64], weights: NDArray[np.float64], config: KldConfig, most: int, *, seed: int, step: int
) -> int:
    """The number of particles to resample to, ``config.least`` to ``most``: drawn until the bins they fall in ask for
    no more.

    Table 8.4 of Probabilistic Robotics, with the particles as they are before resampling for the proposal, poses [N, 3]
    and weights [N]; what it adds to them within a step is small against a bin.
    """
    drawn = _at(generator_for(seed, step, Draws.NUMBER).random(most), weights)
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
    scheme: str, kld: KldConfig, most: int, poses: NDArray[np.float64], weights: Array, *, seed: int, step: int
) -> Parents:
    """The particles [N, 3], as weighed [N], that survive: [M] rising indices, as many as there are or as ``kld`` asks
    for.
    """
    count = len(poses)
    if kld.enabled:
        count = particle_number(poses, weights, kld, most, seed=seed, step=step)
    return SCHEMES[scheme](weights, generator_for(seed, step), count)
