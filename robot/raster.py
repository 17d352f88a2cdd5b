"""A raster: values in square cells that lie somewhere in the plane, such as a map, a floor plan or a coloured floor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot.summary import Summarised


@dataclass(frozen=True, eq=False, repr=False)
class Raster(Summarised):
    """Values in square cells. Row 0 has the smallest y, in memory; files have it at the largest.

    Attributes:
        values: [H, W] or [H, W, C], of any type.
        cell_size: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the outer corner of cell [0, 0].

    Raises:
        InputError: values of another shape, or a cell size that is not positive.
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

    def to_world(self, places: ArrayLike) -> NDArray[np.float64]:
        """Places [n, 2] in columns and rows (cell [0, 0] from (0, 0) to (1, 1)) as points [n, 2] [m]."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        scaled = np.asarray(places, np.float64).reshape(-1, 2) * self.cell_size
        return np.asarray(scaled @ np.array([(cos, sin), (-sin, cos)]) + (x, y))

    def centres(self, cells: ArrayLike) -> NDArray[np.float64]:
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
