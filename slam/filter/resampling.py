"""Resampling: indices of particles drawn in proportion to their weights, by one of three schemes."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Weights = NDArray[np.float64]
Parents = NDArray[np.int64]


def resample(
    scheme: str, weights: Weights, generator: np.random.Generator, count: int | None = None
) -> NDArray[np.int64]:
    """Draw particles in proportion to their weights; a particle of weight w is drawn count * w times on average.

    Args:
        scheme: one of ``SCHEMES``.
        weights: [N] >= 0, not all 0.
        generator: of the uniform numbers.
        count: how many to draw, M; as many as there are if None.

    Returns:
        parents [M], rising: indices into ``weights``, none of them of weight 0.
    """
    return SCHEMES[scheme](weights, generator, count)


def systematic(weights: Weights, generator: np.random.Generator, count: int | None = None) -> Parents:
    """Low-variance resampling with one random number (Probabilistic Robotics, table 4.4).

    A particle of weight w is drawn floor(M w) or ceil(M w) times. Arguments and result as in ``resample``.
    """
    m = len(weights) if count is None else count
    return _at((np.arange(m) + generator.random()) / m, weights)


def stratified(weights: Weights, generator: np.random.Generator, count: int | None = None) -> Parents:
    """One number drawn in each of M equal strata (Kitagawa 1996).

    Unlike the numbers of ``systematic`` they are independent; a particle of weight w is drawn less than 2 times off
    M w. Arguments and result as in ``resample``.
    """
    m = len(weights) if count is None else count
    return _at((np.arange(m) + generator.random(m)) / m, weights)


def residual(weights: Weights, generator: np.random.Generator, count: int | None = None) -> Parents:
    """floor(M w) times for certain, the rest drawn independently from what the floors leave (Liu and Chen 1998).

    Arguments and result as in ``resample``.
    """
    m = len(weights) if count is None else count
    expected = m * weights / weights.sum()
    # equal weights must not lose one of their copies to rounding
    certain = np.floor(expected + 1e-9).astype(np.int64)
    copies = np.repeat(np.arange(len(weights)), certain)[:m]
    left = m - len(copies)
    if left:
        rest = np.maximum(expected - certain, 0.0)
        copies = np.sort(np.concatenate((copies, _at(generator.random(left), rest))))
    return copies.astype(np.int64)


SCHEMES: dict[str, Callable[[Weights, np.random.Generator, int | None], Parents]] = {
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
}
"""What the configuration key ``resampling`` names."""


class Draws(IntEnum):
    """Purposes of random numbers; each has a stream of its own in every step."""

    RESAMPLING = 0
    PROPOSAL = 1
    NUMBER = 3


def generator_for(seed: int, step: int, purpose: Draws = Draws.RESAMPLING) -> np.random.Generator:
    """The host's random numbers of one step and purpose: keyed on (seed, step), independent of any step before it."""
    key = np.array([seed, step], np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=np.array([0, 0, 0, purpose], np.uint64)))


def _at(positions: NDArray[np.float64], weights: Weights) -> Parents:
    """The particles whose share of the interval from 0 to 1 has these positions in it, [M]."""
    cumulative = np.cumsum(weights)
    last = int(np.searchsorted(cumulative, cumulative[-1]))  # those after it weigh nothing
    found = np.searchsorted(cumulative / cumulative[-1], positions, side="right")
    return np.minimum(found, last).astype(np.int64)
