"""What a figure comes to over many runs: median, quartiles, and how well the median is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import inf, isfinite
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Better = Literal["lower", "higher"]

CONFIDENCE = 0.95
RESAMPLES, SEED = 2000, 0
"""Of the bootstrap; the same values have the same interval."""


@dataclass(frozen=True)
class Summary:
    """The values of a figure over runs.

    Runs that failed count as worse than all others: they move the median and the quartiles, which are infinite where
    too many failed, and are never averaged.

    Attributes:
        runs: how many there were, those without a value among them.
        failed: how many failed.
        absent: how many have no value for another reason, such as a map that was not written; these count nowhere.
        median, low_quartile, high_quartile: of all that did not fail to have a value; infinite among failures.
        low, high: bounds of the 95 % bootstrap interval of the median.
        best, worst: of the values.
    """

    runs: int
    failed: int
    absent: int
    median: float | None
    low_quartile: float | None
    high_quartile: float | None
    low: float | None
    high: float | None
    best: float | None
    worst: float | None

    @classmethod
    def of(cls, values: Sequence[float | None], failed: int = 0, *, better: Better = "lower") -> Summary:
        """Summarise runs.

        Args:
            values: of the runs that did not fail; None where one has none.
            failed: how many did.
            better: which values are better: failed runs have the worst.
        """
        there = [value for value in values if value is not None]
        worst = inf if better == "lower" else -inf
        ranked = np.sort(np.array([*there, *[worst] * failed]))
        total, absent = len(values) + failed, len(values) - len(there)
        if not len(ranked):
            return cls(total, failed, absent, *[None] * 7)
        low, high = median_interval(ranked)
        ends = (float(ranked[0]), float(ranked[-1]))
        return cls(
            total,
            failed,
            absent,
            quantile(ranked, 0.5),
            quantile(ranked, 0.25),
            quantile(ranked, 0.75),
            low,
            high,
            *(ends if better == "lower" else ends[::-1]),
        )

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON; an infinite one is None, and ``failed`` says why."""
        return {
            name: value if not isinstance(value, float) or isfinite(value) else None
            for name, value in asdict(self).items()
        }


def quantile(ranked: Array, share: float) -> float:
    """The quantile of values [n] in rising order, between two of them in proportion.

    Infinite beside an infinite one; not a number between two infinite ones of different signs.
    """
    place = share * (len(ranked) - 1)
    below, above = float(ranked[int(np.floor(place))]), float(ranked[int(np.ceil(place))])
    if below == above:
        return below
    share = place - np.floor(place)
    return float((1 - share) * below + share * above)


def median_interval(ranked: Array, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """The percentile bootstrap interval of the median of values [n] in rising order (Efron 1979).

    A single value has itself as both bounds: nothing is known of how it varies.
    """
    generator = np.random.default_rng(SEED)
    n = len(ranked)
    drawn = np.sort(generator.integers(0, n, (RESAMPLES, n)), axis=1)
    below, above = ranked[drawn[:, (n - 1) // 2]], ranked[drawn[:, n // 2]]
    with np.errstate(invalid="ignore"):  # failures of both kinds in the middle
        medians = np.sort(np.where(below == above, below, 0.5 * below + 0.5 * above))
    tail = (1 - confidence) / 2
    return quantile(medians, tail), quantile(medians, 1 - tail)
