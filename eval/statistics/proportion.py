"""How often something happens, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

CONFIDENCE_DEVIATIONS = 1.959963984540054
"""Of a normal variable: 95 % lie within them."""


@dataclass(frozen=True)
class Proportion:
    """A share of runs with its 95 % interval (Wilson 1927), which is right for few runs and for shares of 0 and 1, too.

    Attributes:
        count: runs in which it happened.
        total: all runs; at least 1.
    """

    count: int
    total: int

    @property
    def share(self) -> float:
        """From 0 to 1."""
        return self.count / self.total

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds of the share."""
        z2, n = CONFIDENCE_DEVIATIONS**2, self.total
        middle = (self.share + z2 / (2 * n)) / (1 + z2 / n)
        half = CONFIDENCE_DEVIATIONS / (1 + z2 / n) * (self.share * (1 - self.share) / n + z2 / (4 * n * n)) ** 0.5
        low, high = max(middle - half, 0.0), min(middle + half, 1.0)
        return (0.0 if self.count == 0 else low), (1.0 if self.count == n else high)

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON."""
        low, high = self.interval
        return {"share": self.share, "low": low, "high": high, "count": self.count, "total": self.total}
