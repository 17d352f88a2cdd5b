"""Values in square cells of the plane: a map, a floor plan, a coloured floor; how many cells points lie in.

A file of them is an ``.npz`` of log-odds or of a coloured floor. Its array ``header`` holds JSON, so that
any reader of ``.npz`` files gets at all of it:

    {"format": "moteslam-map", "version": 1, "kind": "log_odds", "cell_size": 0.05, "origin": [-3.0, -2.5, 0.0],
     "units": {"log_odds": "1"}}

Row 0 of every array has the smallest y, in the file as in memory. Nothing is pickled.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import IO, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydantic import ConfigDict, Field

from moteslam.errors import InputError
from moteslam.robot.files import Shape, read_arrays, write_atomically
from moteslam.robot.tables import Number, Section, validated
from moteslam.robot.values import Summarised, expect_type, frozen

Array = NDArray[np.float64]
MapKind = Literal["log_odds", "texture"]

MAX_HEADER = 100_000
MAX_BYTES = 1 << 30
"""Of all arrays of a file: 1 GiB, of log-odds in cells of 5 cm the square of 800 m."""
MAX_PLACE = 1e6
"""No map lies farther from its frame's origin [m]."""
Place = Annotated[Number, Field(ge=-MAX_PLACE, le=MAX_PLACE)]

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


class _Array(NamedTuple):
    """An array of a kind of map: its dtype, and its size beyond rows and columns."""

    dtype: DTypeLike
    depth: tuple[int, ...] = ()


ARRAYS: dict[MapKind, dict[str, _Array]] = {
    "log_odds": {"log_odds": _Array(np.float32)},
    "texture": {"colours": _Array(np.uint8, (3,)), "points": _Array(np.uint32)},
}
"""The arrays of each kind; of log-odds and points 0 is unknown."""


class _Header(Section):
    """What a file says beside its arrays; other keys are passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    format: Literal["moteslam-map"] = "moteslam-map"
    version: Literal[1] = 1
    kind: MapKind
    cell_size: Annotated[Number, Field(gt=0, le=MAX_PLACE)]
    origin: tuple[Place, Place, Place]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MapArrays(Summarised):
    """A map as arrays.

    Attributes:
        kind: ``log_odds`` or ``texture``.
        arrays: of that kind (`ARRAYS`), each [H, W] or [H, W, 3], row 0 the smallest y: ``log_odds``, above 0 occupied;
            ``colours``, red, green and blue, and of how many ``points`` they are the mean.
        cell_size: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the outer corner of cell [0, 0].

    Raises:
        ConfigError: another kind, no positive cell size, or a place off the globe.
        InputError: other arrays, of other shapes or with values out of bounds.
    """

    kind: MapKind
    arrays: Mapping[str, NDArray[Any]]
    cell_size: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        validated(_Header, {"kind": self.kind, "cell_size": self.cell_size, "origin": self.origin})
        wanted = ARRAYS[self.kind]
        if set(self.arrays) != set(wanted):
            raise InputError(f"{', '.join(self.arrays) or 'none'}, expected {', '.join(wanted)}", field="arrays")
        object.__setattr__(self, "arrays", {name: self._checked(name) for name in wanted})

    def raster(self, name: str) -> Raster:
        """One of the arrays, where it lies."""
        return Raster(self.arrays[name], self.cell_size, self.origin)

    def _checked(self, name: str) -> NDArray[Any]:
        about, values = ARRAYS[self.kind][name], np.asarray(self.arrays[name])
        shape = (*np.shape(next(iter(self.arrays.values())))[:2], *about.depth)
        if values.shape != shape or len(shape) != 2 + len(about.depth) or 0 in shape or values.dtype.kind not in "fiu":
            wanted = ", ".join(["H", "W", *map(str, about.depth)])
            raise InputError(f"{values.dtype}{list(values.shape)}, expected numbers [{wanted}]", field=name)
        kind = np.dtype(about.dtype)
        bounds = np.finfo(kind) if kind.kind == "f" else np.iinfo(kind)
        if not ((values >= bounds.min) & (values <= bounds.max)).all():
            raise InputError(f"expected finite values from {bounds.min:g} to {bounds.max:g}", field=name)
        return frozen(values, kind)


def write_map_arrays(path: str | PathLike[str], map_arrays: MapArrays) -> None:
    """Write a map as ``.npz``, compressed; the same map gives the same bytes, and reads back the same, bit for bit.

    Raises:
        OutputError: it cannot be written.
    """
    expect_type(map_arrays, MapArrays, "map_arrays")
    header: dict[str, Any] = {"format": "moteslam-map", "version": 1, "kind": map_arrays.kind}
    header |= {"cell_size": float(map_arrays.cell_size), "origin": [float(value) for value in map_arrays.origin]}
    header |= {"units": dict.fromkeys(map_arrays.arrays, "1")}
    content = np.frombuffer(json.dumps(header, allow_nan=False).encode(), np.uint8)
    arrays: dict[str, Any] = {"header": content, **map_arrays.arrays}

    def write(file: IO[bytes]) -> None:
        np.savez_compressed(file, **arrays)

    write_atomically(path, write)


def read_map_arrays(path: str | PathLike[str]) -> MapArrays:
    """Read a map written by `write_map_arrays`. Keys of the header that are not known here are passed over.

    Raises:
        ConfigError: no header of this format, or one of a newer version.
        InputError: no ``.npz`` file, or arrays that are missing, of other shapes or of more than 1 GiB, or values out
            of bounds; file and field are named.
    """
    path = Path(path)
    content = read_arrays(path, {"header": ("n",)}, max_bytes=MAX_HEADER)["header"]
    try:
        table = json.loads(content.tobytes()) if content.dtype == np.uint8 else None
    except (ValueError, RecursionError) as error:
        raise InputError("expected JSON", file=path, field="header") from error
    header = validated(_Header, table, file=path, above="header")
    shapes: dict[str, Shape] = {name: ("rows", "columns", *about.depth) for name, about in ARRAYS[header.kind].items()}
    arrays = read_arrays(path, shapes, max_bytes=MAX_BYTES)
    try:
        return MapArrays(kind=header.kind, arrays=arrays, cell_size=header.cell_size, origin=header.origin)
    except InputError as error:
        raise InputError(error.problem, file=path, field=error.field) from error
