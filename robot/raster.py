"""Values in square cells of the plane: a map, a floor plan, a coloured floor; how many cells points lie in."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot.values import Summarised

Array = NDArray[np.float64]

GRIDS = 4
"""Directions of the grid: a wall along the edges of the cells of one alone would count once or twice by chance."""
LARGEST_GRID = 1 << 27
"""Cells of larger grids, 580 m square in cells of 5 cm, are counted by sorting."""


@dataclass(frozen=True, eq=False, repr=False)
class Raster(Summarised):
    """Values in square cells. Row 0 has the smallest y, in memory; files have it at the largest.

    Attributes:
        values: [H, W] or [H, W, C], of any type.
        cell_size: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the outer corner of cell [0, 0].
    """

    values: NDArray[Any]
    cell_size: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not isinstance(self.values, np.ndarray):
            object.__setattr__(self, "values", np.array(self.values))
        if self.values.ndim not in (2, 3):
            raise InputError(f"values of {self.values.shape}, expected [H, W] or [H, W, C]")
        if not (math.isfinite(self.cell_size) and self.cell_size > 0):
            raise InputError(f"cells of {self.cell_size} m, expected a positive size")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[0], self.values.shape[1]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top [m] of a raster that is not turned, as pictures of it need them."""
        (rows, columns), (x, y, _) = self.shape, self.origin
        return x, x + columns * self.cell_size, y, y + rows * self.cell_size

    def to_world(self, places: ArrayLike) -> Array:
        """Places [n, 2] in columns and rows (cell [0, 0] from (0, 0) to (1, 1)) as points [n, 2] [m]."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        scaled = np.asarray(places, np.float64).reshape(-1, 2) * self.cell_size
        return np.asarray(scaled @ np.array([(cos, sin), (-sin, cos)]) + (x, y))

    def centres(self, cells: ArrayLike) -> Array:
        """The centres [n, 2] [m] of cells [n, 2] (row, column)."""
        return self.to_world(np.asarray(cells).reshape(-1, 2)[:, ::-1] + 0.5)

    def values_at(self, points: ArrayLike, *, outside: Any) -> NDArray[Any]:
        """The values [n] or [n, C] of the cells that points [n, 2] [m] lie in; beyond the edges ``outside``."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        away = np.asarray(points, np.float64).reshape(-1, 2) - (x, y)
        at = np.floor(away @ np.array([(cos, -sin), (sin, cos)]) / self.cell_size)
        rows, columns = self.shape
        inside = (at >= 0).all(1) & (at[:, 0] < columns) & (at[:, 1] < rows)
        found = np.full((len(at), *self.values.shape[2:]), outside, self.values.dtype)
        column, row = at[inside].astype(np.int64).T
        found[inside] = self.values[row, column]
        return found

    def _summary(self) -> str:
        rows, columns = self.shape
        size = f"{columns * self.cell_size:.1f} x {rows * self.cell_size:.1f} m"
        return f"{self.values.dtype}{list(self.values.shape)}, {size} in cells of {self.cell_size:g} m"


def cells_of(points: Array, size: float) -> Iterator[NDArray[np.int64]]:
    """For each direction of the grid the numbers [p], from 0 on, of the cells that points [p, 2] lie in; all in m."""
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
    """The number of different cells that hold a point, for each direction [GRIDS] of the grid; see ``cells_of``.

    Of two maps of the same scans the one that needs fewer is sharper.
    """
    return np.array([_distinct(cells) for cells in cells_of(points, size)])


def _distinct(cells: NDArray[np.int64]) -> int:
    last = int(cells.max())
    if last >= LARGEST_GRID:
        return len(np.unique(cells))
    seen = np.zeros(last + 1, bool)
    seen[cells] = True
    return int(np.count_nonzero(seen))
