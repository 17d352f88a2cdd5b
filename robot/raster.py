"""Values in square cells of the plane: a map, a floor plan, a coloured floor; how many cells points lie in.

A file of them is an ``.npz`` of log-odds, of a TSDF or of a coloured floor. Its array ``header`` holds JSON, so that
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
from typing import IO, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from moteslam.errors import InputError
from moteslam.robot.files import Shape, read_arrays, write_atomically
from moteslam.robot.values import Summarised, expect_type, frozen, shortened

Array = NDArray[np.float64]
MapKind = Literal["log_odds", "tsdf", "texture"]

NAME, VERSION = "moteslam-map", 1
MAX_HEADER = 100_000
MAX_BYTES = 1 << 30
"""Of all arrays of a file: 1 GiB, of log-odds in cells of 5 cm the square of 800 m."""
MAX_PLACE = 1e6
"""No map lies farther from its frame's origin [m]."""

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
    """An array of a kind of map: its dtype, its size beyond rows and columns, the unit of its numbers, their least."""

    dtype: DTypeLike
    depth: tuple[int, ...] = ()
    unit: str = "1"
    least: float = -np.inf


ARRAYS: dict[MapKind, dict[str, _Array]] = {
    "log_odds": {"log_odds": _Array(np.float32)},
    "tsdf": {"distance": _Array(np.float32, unit="m"), "weight": _Array(np.uint16, least=0)},
    "texture": {"colours": _Array(np.uint8, (3,), least=0), "points": _Array(np.uint32, least=0)},
}
"""The arrays of each kind; of log-odds, weights and points 0 is unknown."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MapArrays(Summarised):
    """A map as arrays.

    Attributes:
        kind: ``log_odds``; ``tsdf``; or ``texture``.
        arrays: of that kind (`ARRAYS`), each [H, W] or [H, W, 3], row 0 the smallest y: ``log_odds``, above 0 occupied;
            ``distance`` to the nearest surface [m], positive in front of it, and its ``weight``; ``colours``, red,
            green and blue, and of how many ``points`` they are the mean.
        cell_size: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the outer corner of cell [0, 0].
        truncation: of the distances [m], of a TSDF alone.

    Raises:
        InputError: other arrays, of other shapes or with values out of bounds; no positive cell size; a place off the
            globe; or a TSDF without truncation.
    """

    kind: MapKind
    arrays: Mapping[str, NDArray[Any]]
    cell_size: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    truncation: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in ARRAYS:
            raise InputError(f"{shortened(self.kind)}, expected one of {', '.join(ARRAYS)}", field="kind")
        wanted = ARRAYS[self.kind]
        if set(self.arrays) != set(wanted):
            raise InputError(f"{', '.join(self.arrays) or 'none'}, expected {', '.join(wanted)}", field="arrays")
        for field in ("cell_size", "truncation") if self.kind == "tsdf" else ("cell_size",):
            value = getattr(self, field)
            if not _is_place(value) or value <= 0:
                raise InputError(f"{shortened(value)}, expected a positive length [m]", field=field)
        if self.kind != "tsdf" and self.truncation is not None:
            raise InputError(f"{self.truncation!r}, expected none of the kind {self.kind}", field="truncation")
        if len(self.origin) != 3 or not all(map(_is_place, self.origin)):
            problem = f"{shortened(self.origin)}, expected three numbers: x, y [m] and yaw [rad]"
            raise InputError(problem, field="origin")
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
        most = np.finfo(kind).max if kind.kind == "f" else np.iinfo(kind).max
        if name == "distance" and self.truncation is not None:
            most = self.truncation * (1 + 1e-6)  # rounded to float32
        least = max(about.least, -float(most))
        if not ((values >= least) & (values <= most)).all():
            raise InputError(f"expected finite values from {least:g} to {float(most):g}", field=name)
        return frozen(values, kind)


def _is_place(value: object) -> bool:
    """Whether something is a number within ``MAX_PLACE``, and so finite."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_PLACE


def write_map_arrays(path: str | PathLike[str], map_arrays: MapArrays) -> None:
    """Write a map as ``.npz``, compressed; the same map gives the same bytes, and reads back the same, bit for bit.

    Raises:
        OutputError: it cannot be written.
    """
    expect_type(map_arrays, MapArrays, "map_arrays")
    units = {name: about.unit for name, about in ARRAYS[map_arrays.kind].items()}
    header: dict[str, Any] = {"format": NAME, "version": VERSION, "kind": map_arrays.kind}
    header |= {"cell_size": float(map_arrays.cell_size), "origin": [float(value) for value in map_arrays.origin]}
    header |= {} if map_arrays.truncation is None else {"truncation": float(map_arrays.truncation)}
    content = np.frombuffer(json.dumps(header | {"units": units}, allow_nan=False).encode(), np.uint8)

    arrays: dict[str, Any] = {"header": content, **map_arrays.arrays}

    def write(file: IO[bytes]) -> None:
        np.savez_compressed(file, **arrays)

    write_atomically(path, write)


def read_map_arrays(path: str | PathLike[str]) -> MapArrays:
    """Read a map written by `write_map_arrays`. Keys of the header that are not known here are passed over.

    Raises:
        InputError: no ``.npz`` file, no header of this format or one of a newer version, arrays that are missing, of
            other shapes or of more than 1 GiB, or values out of bounds; file and field are named.
    """
    path = Path(path)
    content = read_arrays(path, {"header": ("n",)}, max_bytes=MAX_HEADER)["header"]
    try:
        header = json.loads(content.tobytes()) if content.dtype == np.uint8 else None
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict) or header.get("format") != NAME:
        raise InputError(f'expected JSON with "format": "{NAME}"', file=path, field="header")
    if header.get("version") != VERSION or isinstance(header["version"], bool):
        problem = f"{shortened(header.get('version'))}, expected {VERSION}: a newer moteslam reads a later one"
        raise InputError(problem, file=path, field="header.version")
    kind, origin = header.get("kind"), header.get("origin")
    names = next((arrays for name, arrays in ARRAYS.items() if name == kind), {})
    shapes: dict[str, Shape] = {name: ("rows", "columns", *about.depth) for name, about in names.items()}
    try:
        return MapArrays(
            kind=kind,  # type: ignore[arg-type]
            arrays=read_arrays(path, shapes, max_bytes=MAX_BYTES),
            cell_size=header.get("cell_size"),  # type: ignore[arg-type]
            origin=tuple(origin) if isinstance(origin, list) else (),
            truncation=header.get("truncation"),
        )
    except InputError as error:
        if error.file is not None:
            raise
        field = error.field if error.field in names else f"header.{error.field}"
        raise InputError(error.problem, file=path, field=field) from error
