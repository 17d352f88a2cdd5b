"""Which particles live on: indices drawn in proportion to the weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def systematic(weights: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.int64]:
    """Low-variance resampling with one random number (Probabilistic Robotics, table 4.4).

    Args:
        weights: [N], sum 1.
        generator: of the one uniform number.

    Returns:
        parents [N], rising; a particle of weight w appears floor(N w) or ceil(N w) times.
    """
    n = len(weights)
    positions = (np.arange(n) + generator.random()) / n
    cumulative = np.cumsum(weights)
    return np.minimum(np.searchsorted(cumulative / cumulative[-1], positions, side="right"), n - 1).astype(np.int64)


def generator_for(seed: int, step: int) -> np.random.Generator:
    """The host's random numbers of one step: keyed on (seed, step), independent of any step before it."""
    return np.random.Generator(np.random.Philox(key=np.array([seed, step], np.uint64)))
