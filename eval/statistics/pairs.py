"""Two configurations on the same runs: the differences in pairs, which leave out what makes one seed harder."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import asdict, dataclass
from math import inf, isclose, isfinite
from typing import Any, TypeVar

import numpy as np

from moteslam.eval.statistics.summary import Better, median_interval, quantile

K = TypeVar("K", bound=Hashable)

ROUNDING = 1e-12
"""Values that differ by no more than this share of the larger one are equal."""


@dataclass(frozen=True)
class Comparison:
    """How a second configuration does against a first one on the same runs.

    A run that failed loses against one that did not; where both failed, neither wins, and the pair has no difference.

    Attributes:
        pairs: runs that both have.
        wins, losses, ties: of the second one.
        median: of the differences, second less first; infinite where failures decide it, None without any.
        low, high: bounds of its 95 % bootstrap interval.
        p: of the two-sided sign test: how probable so uneven wins are between equals; 1 where there is neither.
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

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON; an infinite one is None, and ``failed`` says why."""
        return {
            name: value if not isinstance(value, float) or isfinite(value) else None
            for name, value in asdict(self).items()
        }


def compare(
    first: Mapping[K, float | None], second: Mapping[K, float | None], *, better: Better = "lower"
) -> Comparison:
    """Compare two configurations.

    Args:
        first, second: the figure of each run by what it has in common with the other's: scenario, platform, seed. None
            for a run that failed.
        better: which values are better.
    """
    common = [key for key in first if key in second]
    worst = inf if better == "lower" else -inf
    values = [tuple(worst if value is None else value for value in (first[key], second[key])) for key in common]
    apart = [(a, b) for a, b in values if not isclose(a, b, rel_tol=ROUNDING)]
    wins = sum((b < a) if better == "lower" else (b > a) for a, b in apart)
    losses = len(apart) - wins
    differences = np.sort(np.array([b - a for a, b in values if isfinite(a) or isfinite(b)]))
    some = len(differences) > 0
    low, high = median_interval(differences) if some else (None, None)
    return Comparison(
        pairs=len(common),
        wins=wins,
        losses=losses,
        ties=len(common) - wins - losses,
        median=quantile(differences, 0.5) if some else None,
        low=low,
        high=high,
        p=_sign_test(wins, losses),
        failed=(sum(first[key] is None for key in common), sum(second[key] is None for key in common)),
        apart=len(first) + len(second) - 2 * len(common),
    )


def _sign_test(wins: int, losses: int) -> float:
    from scipy.stats import binomtest

    return float(binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0
