"""The particles' weights as one immutable value."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Weights:
    """Normalised importance weights, kept as logarithms."""

    log: NDArray[np.float64]  # [N] float64, log of weights that sum to 1

    @classmethod
    def uniform(cls, n: int) -> Self:
        """N equal weights (section III.D of the paper)."""
        return cls(np.full(n, -np.log(n)))

    @cached_property
    def values(self) -> NDArray[np.float64]:
        """The weights [N]; they sum to 1."""
        values = np.exp(self.log)
        values.setflags(write=False)
        return values

    @cached_property
    def effective_number(self) -> float:
        """1 / sum of squared weights, from 1 to N (III.4 with the square that the paper's formula lacks)."""
        return float(1 / np.square(self.values).sum())

    @cached_property
    def best(self) -> int:
        """The index of the largest weight, the first of equal ones (section II.B)."""
        return int(np.argmax(self.log))

    def times_log(self, log_likelihood: NDArray[np.float64]) -> "Weights":
        """Multiplied by a likelihood given as its logarithm [N], and normalised (II.7)."""
        log = self.log + log_likelihood
        log = log - log.max()
        return Weights(log - np.log(np.exp(log).sum()))

    def times(self, likelihood: ArrayLike) -> "Weights":
        """Multiplied by a likelihood [N] >= 0 and normalised (II.7); zeros alone leave the weights as they are."""
        with np.errstate(divide="ignore"):
            log = np.log(np.asarray(likelihood, np.float64))
        return self.times_log(log) if np.isfinite((self.log + log).max()) else self
