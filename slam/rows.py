"""Rows of numbers that are added one by one or many at once."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray


class Rows:
    """Rows [n, columns] that are added at the end, and may be forgotten from the beginning on.

    With the ``order`` F each column lies in one piece: to be searched, which otherwise copies it first.
    """

    def __init__(self, columns: int, dtype: type = np.float64, order: Literal["C", "F"] = "C") -> None:
        self._table: NDArray[Any] = np.empty((64, columns), dtype, order)
        self._order = order
        self._first = self._last = 0

    def __len__(self) -> int:
        return self._last - self._first

    def add(self, *columns: NDArray[Any]) -> None:
        """Add rows, of columns [m] and [m, k]."""
        count, column = len(columns[0]), 0
        if self._last + count > len(self._table):
            kept = self.values
            size = 2 * len(kept) + count
            if size > len(self._table):
                self._table = np.empty((size, kept.shape[1]), kept.dtype, self._order)
            self._table[: len(kept)] = kept
            self._first, self._last = 0, len(kept)
        new = self._table[self._last : self._last + count]
        self._last += count
        for some in columns:
            width = some.shape[1] if some.ndim > 1 else 1
            new[:, column : column + width] = some if some.ndim > 1 else some[:, None]
            column += width

    @property
    def values(self) -> NDArray[Any]:
        """[n, columns]; they hold until the next row is added."""
        return self._table[self._first : self._last]

    def forget_latest(self) -> None:
        self._last -= 1

    def keep(self, count: int) -> None:
        """Forget all but the latest."""
        self._first = max(self._first, self._last - count)


def summed(start: float, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """The running sum [m], added up one by one from a start."""
    return np.cumsum(np.append(start, steps))[1:]
