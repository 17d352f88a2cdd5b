"""The true map: which cells of a grid a wall crosses, which the robot could ever see, at any resolution."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import ConfigError
from moteslam.robot.files import write_atomically
from moteslam.sim.world import World

FREE, OCCUPIED, UNKNOWN = 0, 1, -1
MAX_CELLS = 64_000_000


@dataclass(frozen=True, eq=False)
class TrueMap:
    """The standing world as cells.

    Attributes:
        cells: int8 [rows, cols], row 0 the smallest y: 0 free, 1 occupied, -1 what no way leads to.
        cell_size: [m].
        origin: x, y of the outer corner of cell [0, 0] [m].
    """

    cells: NDArray[np.int8]
    cell_size: float
    origin: tuple[float, float]

    def centres(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """The centres [n, 2] [m] of cells [n, 2] (row, col)."""
        return np.asarray(np.asarray(self.origin) + (cells[:, ::-1] + 0.5) * self.cell_size, np.float64)


def true_map(world: World, resolution: float, *, seen_from: ArrayLike, margin: float = 0.5) -> TrueMap:
    """Rasterise a world.

    A cell is occupied that a wall crosses or whose centre lies in a solid; free if a way leads to it, from cell to
    cell across their sides, from where the robot was; all others are unknown. Cell [0, 0] begins at a multiple of the
    resolution, so that maps of one world lie on one another.

    Args:
        world: to rasterise.
        resolution: a cell's side [m].
        seen_from: [n, 2] places of the robot [m].
        margin: round the world [m].

    Raises:
        ConfigError: a resolution that is not positive, or so fine that the cells are too many.
    """
    from scipy.ndimage import label

    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"{resolution}, expected a positive length [m]", field="resolution")
    points = np.asarray(seen_from, np.float64).reshape(-1, 2)
    x0, y0, x1, y1 = world.bounds
    low = np.minimum((x0, y0), points.min(0)) - margin
    high = np.maximum((x1, y1), points.max(0)) + margin
    first = np.floor(low / resolution)
    cols, rows = (int(n) for n in np.ceil(high / resolution) - first)
    if cols * rows > MAX_CELLS:
        raise ConfigError(
            f"{cols} x {rows} cells of {resolution:g} m, expected at most {MAX_CELLS} in all", field="resolution"
        )
    origin = first * resolution
    occupied = np.zeros((rows, cols), bool)
    for line in world.segments:
        cell = _crossed(line, resolution) - first.astype(np.int64)
        occupied[cell[:, 1], cell[:, 0]] = True
    _fill_solids(world, occupied, origin, resolution)
    regions, _ = label(~occupied)
    at = np.floor(points / resolution).astype(np.int64) - first.astype(np.int64)
    reached = np.unique(regions[at[:, 1], at[:, 0]])
    free = np.isin(regions, reached[reached > 0])
    cells = np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.int8)
    return TrueMap(cells, float(resolution), (float(origin[0]), float(origin[1])))


def write_true_map(path: str | PathLike[str], true: TrueMap) -> None:
    """Write a ``.pgm`` and beside it the ``.yaml``, as map_server and nav2 read them (trinary).

    Raises:
        OutputError: one of them cannot be written.
    """
    path = Path(path)
    image = np.where(true.cells == OCCUPIED, 0, np.where(true.cells == FREE, 254, 205)).astype(np.uint8)[::-1]
    rows, cols = image.shape
    write_atomically(path, f"P5\n{cols} {rows}\n255\n".encode() + image.tobytes())
    x, y = true.origin
    write_atomically(
        path.with_suffix(".yaml"),
        f"image: {path.name}\nmode: trinary\nresolution: {true.cell_size!r}\norigin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
    )


def _crossed(line: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    """Every cell (col, row) [n, 2] that a segment crosses: the middle of each piece between two cell sides."""
    a, b = line[:2] / size, line[2:] / size
    cuts = [np.array((0.0, 1.0))]
    for axis in (0, 1):
        low, high = sorted((a[axis], b[axis]))
        if high > low:
            sides = np.arange(np.ceil(low), np.floor(high) + 1)
            cuts.append(np.clip((sides - a[axis]) / (b[axis] - a[axis]), 0.0, 1.0))
    share = np.unique(np.concatenate(cuts))
    middle = (share[1:] + share[:-1]) / 2
    return np.asarray(np.floor(a + middle[:, None] * (b - a)), np.int64)


def _fill_solids(world: World, occupied: NDArray[np.bool_], origin: NDArray[np.float64], size: float) -> None:
    """Mark the cells whose centres lie within solids."""
    rows, cols = occupied.shape
    if world.plan is not None:
        row, col = np.mgrid[:rows, :cols]
        centres = np.stack((col.ravel(), row.ravel()), axis=-1) * size + origin + size / 2
        occupied |= world.plan.is_solid(centres).reshape(rows, cols)
    for polygon in world.solids:
        low = np.maximum(np.floor((polygon.min(0) - origin) / size), 0).astype(np.int64)
        high = np.minimum(np.ceil((polygon.max(0) - origin) / size), (cols, rows)).astype(np.int64)
        row, col = np.mgrid[low[1] : high[1], low[0] : high[0]]
        centres = np.stack((col.ravel(), row.ravel()), axis=-1) * size + origin + size / 2
        inside = World(world.segments, (polygon,)).inside_solid(centres)
        occupied[low[1] : high[1], low[0] : high[0]] |= inside.reshape(row.shape)
