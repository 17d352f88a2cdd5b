"""Figures of parts of a recording: deviations by how these scatter, and where in it a figure changes."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import Array

BLOCKS = 25
"""Parts of a recording whose scatter gives the deviations."""
FEWEST = 15
"""Of fewer values there is no mean."""


class Change(NamedTuple):
    """From a time on [s] a figure is larger by an amount, with its deviation."""

    time: float = 0.0
    amount: float = 0.0
    deviation: float = 1.0

    def exceeds(self, least: float, sigmas: float) -> bool:
        """Whether the amount does, and as many standard deviations."""
        return abs(self.amount) > max(least, sigmas * self.deviation)


def clearest_change(first: Array, estimate: Callable[[NDArray[np.bool_]], tuple[float, float]]) -> Change:
    """Of those at the eighths of pairs that begin at times [k] [s]; ``estimate`` gives a figure of some of the pairs,
    which are those of a mask [k], and its deviation.
    """
    found = Change()
    for time in np.quantile(first, np.arange(1, 8) / 8).tolist():
        (before, about_before), (after, about_after) = (estimate(some) for some in (first < time, first >= time))
        change = Change(time, after - before, float(np.hypot(about_before, about_after)))
        if abs(change.amount) / change.deviation > abs(found.amount) / found.deviation:
            found = change
    return found


def robust_mean(values: Array, weights: Array, scale: float, floor: float) -> tuple[float, float]:
    """The mean of values [k], of which those count less that are farther than ``scale`` from it; and its deviation."""
    if len(values) < FEWEST:
        return 0.0, np.inf
    mean = float(np.median(values))
    for _ in range(8):
        each = weights / (1 + ((values - mean) / scale) ** 2)
        mean = float((each * values).sum() / each.sum())
    return mean, float(np.hypot(np.linalg.norm(parts_of(each * (values - mean))) / each.sum(), floor))


def parts_of(values: Array) -> Array:
    """The sums [BLOCKS, ...] over parts of a recording of values [k, ...]."""
    return np.array([part.sum(axis=0) for part in np.array_split(values, min(BLOCKS, len(values)))])
