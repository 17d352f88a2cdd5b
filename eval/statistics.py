"""Statistics of a set of errors; of a figure over many runs; of two configurations on the same runs."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import inf, isclose, isfinite
from typing import Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Better = Literal["lower", "higher"]
K = TypeVar("K", bound=Hashable)

CONFIDENCE = 0.95
FEWEST = 6
"""Fewer values have no interval; of the median, even the range of five holds it in 94 % of samples alone."""
RESAMPLES, SEED = 2000, 0  # Of the bootstrap; the same values have the same interval
ROUNDING = 1e-12  # Values that differ by no more than this share of the larger one are equal


@dataclass(frozen=True)
class Statistics:
    """Statistics of a set of errors, in their unit; ``std`` is the population's."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    count: int

    @classmethod
    def of(cls, errors: ArrayLike) -> Self:
        """The statistics of errors [n], n at least 1."""
        errors = np.asarray(errors, np.float64)
        rmse, median = float(np.sqrt(np.mean(errors**2))), float(np.median(errors))
        mean, std, least, most = (float(value) for value in (errors.mean(), errors.std(), errors.min(), errors.max()))
        return cls(rmse, mean, median, std, least, most, len(errors))

    def as_dict(self) -> dict[str, float | int]:
        return asdict(self)


@dataclass(frozen=True)
class Summary:
    """The values of a figure over ``runs``, of which some failed and some have no value for another reason
    (``absent``).

    Runs that failed count as worse than all others: they move the median and the quartiles, which are infinite where
    too many failed. ``low`` and ``high`` bound the 95 % bootstrap interval of the median.
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
    def of(cls, values: Sequence[float | None], failed: int = 0, *, better: Better = "lower") -> Self:
        """Summarise the values of the runs that did not fail (None: absent), and the number of those that did."""
        there = [value for value in values if value is not None]
        worst = inf if better == "lower" else -inf
        ranked = np.sort(np.array([*there, *[worst] * failed]))
        total, absent = len(values) + failed, len(values) - len(there)
        if not len(ranked):
            return cls(total, failed, absent, *[None] * 7)
        median, low_quartile, high_quartile = (quantile(ranked, share) for share in (0.5, 0.25, 0.75))
        best, worst = (float(ranked[end]) for end in ((0, -1) if better == "lower" else (-1, 0)))
        low, high = median_interval(ranked)
        return cls(total, failed, absent, median, low_quartile, high_quartile, low, high, best, worst)


@dataclass(frozen=True)
class Proportion:
    """A share of runs, ``count`` of ``total`` (at least 1), with its 95 % interval (Wilson 1927); of few runs none."""

    count: int
    total: int

    @property
    def share(self) -> float:
        return self.count / self.total

    @property
    def interval(self) -> tuple[float, float] | tuple[None, None]:
        from scipy.stats import binomtest

        if self.total < FEWEST:
            return None, None
        low, high = binomtest(self.count, self.total).proportion_ci(CONFIDENCE, method="wilson")
        return float(low), float(high)

    def as_dict(self) -> dict[str, Any]:
        low, high = self.interval
        return {"share": self.share, "low": low, "high": high, "count": self.count, "total": self.total}

    @property
    def range(self) -> str:
        """The interval in words."""
        low, high = self.interval
        return "" if low is None or high is None else f" ({100 * low:.0f} to {100 * high:.0f} %)"


@dataclass(frozen=True)
class Comparison:
    """How a second configuration does against a first one on the same runs: wins, losses and ties of it among the
    pairs.

    A run that failed loses against one that did not; where both failed, neither wins, and the pair has no difference.

    Attributes:
        median: of the differences, second less first; infinite where failures decide it, None without any.
        low, high: bounds of its 95 % bootstrap interval.
        p: of the two-sided sign test; 1 where neither wins.
        failed: of the first and of the second one, among the pairs.
        apart: runs that only one of the two has.
    """

    pairs: int
    wins: int
    losses: int
    ties: int
    median: float | None
    low: float | None
    high: float | None
    p: float
    failed: tuple[int, int]
    apart: int


def compare(
    first: Mapping[K, float | None], second: Mapping[K, float | None], *, better: Better = "lower"
) -> Comparison:
    """Compare two configurations, each given as the figure of each run, None for one that failed.

    Runs with the same key (scenario, platform, seed, ...) are a pair.
    """
    from scipy.stats import binomtest

    common = [key for key in first if key in second]
    worst = inf if better == "lower" else -inf
    values = [tuple(worst if value is None else value for value in (first[key], second[key])) for key in common]
    apart = [(a, b) for a, b in values if not isclose(a, b, rel_tol=ROUNDING)]
    wins = sum((b < a) if better == "lower" else (b > a) for a, b in apart)
    losses = len(apart) - wins
    differences = np.sort(np.array([b - a for a, b in values if isfinite(a) or isfinite(b)]))
    low, high = median_interval(differences)
    median = quantile(differences, 0.5) if len(differences) else None
    p = float(binomtest(wins, len(apart)).pvalue) if apart else 1.0
    failed = sum(first[key] is None for key in common), sum(second[key] is None for key in common)
    ties, alone = len(common) - len(apart), len(first) + len(second) - 2 * len(common)
    return Comparison(len(common), wins, losses, ties, median, low, high, p, failed, alone)


def quantile(ranked: Array, share: float) -> float:
    """The quantile of values [n] in rising order, interpolated; infinite beside an infinite one."""
    place = share * (len(ranked) - 1)
    below, above = float(ranked[int(np.floor(place))]), float(ranked[int(np.ceil(place))])
    if below == above:
        return below
    share = place - np.floor(place)
    return float((1 - share) * below + share * above)


def median_interval(ranked: Array) -> tuple[float, float] | tuple[None, None]:
    """The 95 % percentile bootstrap interval of the median of values [n] in rising order (Efron 1979)."""
    if (n := len(ranked)) < FEWEST:
        return None, None
    generator = np.random.default_rng(SEED)
    drawn = np.sort(generator.integers(0, n, (RESAMPLES, n)), axis=1)
    below, above = ranked[drawn[:, (n - 1) // 2]], ranked[drawn[:, n // 2]]
    with np.errstate(invalid="ignore"):  # infinities of both signs in the middle
        medians = np.sort(np.where(below == above, below, 0.5 * below + 0.5 * above))
    tail = (1 - CONFIDENCE) / 2
    return quantile(medians, tail), quantile(medians, 1 - tail)
