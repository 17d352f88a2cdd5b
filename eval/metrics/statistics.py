"""The statistics of a set of errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Statistics:
    """What a set of errors amounts to, in the unit of the errors.

    Attributes:
        rmse: root of the mean square.
        mean, median, std, min, max: as NumPy has them (std of the population, not of a sample).
        count: how many errors there were.
    """

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    count: int

    @classmethod
    def of(cls, errors: ArrayLike) -> Statistics:
        """The statistics of errors [n], n at least 1."""
        errors = np.asarray(errors, np.float64)
        return cls(
            rmse=float(np.sqrt(np.mean(errors**2))),
            mean=float(errors.mean()),
            median=float(np.median(errors)),
            std=float(errors.std()),
            min=float(errors.min()),
            max=float(errors.max()),
            count=len(errors),
        )

    def as_dict(self) -> dict[str, float | int]:
        """The statistics by name, as they go into ``metrics.json``."""
        return asdict(self)
