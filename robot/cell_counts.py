"""How many cells hold points: of two maps of the same scans the one that needs fewer is sharper."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRIDS = 4
"""Directions of the grid: a wall along the edges of the cells of one alone would count once or twice by chance."""
LARGEST_GRID = 1 << 27
"""Cells of larger grids, 580 m square in cells of 5 cm, are counted by sorting."""


def cells_of(points: Array, size: float) -> Iterator[NDArray[np.int64]]:
    """For each direction of the grid the numbers [p], from 0 on, of the cells of that size [m] that points lie in.

    Args:
        points: [p, 2] [m], at least one.
        size: edge of a cell [m].
    """
    x, y = np.ascontiguousarray(points.T) / size
    for angle in np.arange(1, GRIDS + 1) * (np.pi / 2 / (GRIDS + 1)):
        c, s = np.cos(angle), np.sin(angle)
        columns, rows = np.floor(c * x + s * y), np.floor(c * y - s * x)
        columns, rows = columns - columns.min(), rows - rows.min()
        yield (rows * (int(columns.max()) + 1) + columns).astype(np.int64)


def mean_cells(points: Array, size: float) -> float:
    """The mean number of different cells that hold a point, over the directions of the grid; see ``cells_of``."""
    return float(cell_counts(points, size).mean())


def cell_counts(points: Array, size: float) -> NDArray[np.int64]:
    """The number of different cells that hold a point, for each direction [GRIDS] of the grid; see ``cells_of``."""
    return np.array([_distinct(cells) for cells in cells_of(points, size)])


def _distinct(cells: NDArray[np.int64]) -> int:
    last = int(cells.max())
    if last >= LARGEST_GRID:
        return len(np.unique(cells))
    seen = np.zeros(last + 1, bool)
    seen[cells] = True
    return int(np.count_nonzero(seen))
