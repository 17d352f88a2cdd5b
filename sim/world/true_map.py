"""The true map: which cells of a grid a wall crosses, and which of the others can be reached, at any resolution."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.raster import Raster
from moteslam.sim.world.world import World

MAX_CELLS = 64_000_000


def true_map(world: World, resolution: float, *, seen_from: ArrayLike, margin: float = 0.5) -> Raster:
    """Rasterise a world into `FREE`, `OCCUPIED` or `UNKNOWN` cells int8 [H, W] of a side ``resolution`` [m].

    A cell is occupied if a wall crosses it or its centre lies in a solid; free if it can be reached, from cell to
    cell across their sides, from where the robot was (``seen_from`` [n, 2] [m]); all others are unknown. Cell [0, 0]
    begins at a multiple of the resolution, so that maps of one world lie on one another.
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
    values = np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.int8)
    return Raster(values, float(resolution), (float(origin[0]), float(origin[1]), 0.0))


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
    """Mark the cells whose centres lie within solids; hollows stay free."""
    import shapely

    rows, cols = occupied.shape
    if world.plan is not None:
        centres = _centres(np.array((0, 0)), np.array((cols, rows)), origin, size)
        occupied |= world.plan.values_at(centres, outside=False).reshape(rows, cols)
    for polygon in world.solids:
        low = np.maximum(np.floor((polygon.min(0) - origin) / size), 0).astype(np.int64)
        high = np.minimum(np.ceil((polygon.max(0) - origin) / size), (cols, rows)).astype(np.int64)
        inside = shapely.contains_xy(shapely.Polygon(polygon), _centres(low, high, origin, size))
        occupied[low[1] : high[1], low[0] : high[0]] |= inside.reshape(high[1] - low[1], high[0] - low[0])


def _centres(
    low: NDArray[np.int64], high: NDArray[np.int64], origin: NDArray[np.float64], size: float
) -> NDArray[np.float64]:
    """The centres [n, 2] [m] of the cells from (col, row) ``low`` to before ``high``, row by row."""
    row, col = np.mgrid[low[1] : high[1], low[0] : high[0]]
    return np.asarray(np.stack((col.ravel(), row.ravel()), axis=-1) * size + origin + size / 2)
