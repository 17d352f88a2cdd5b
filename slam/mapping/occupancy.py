"""The occupancy grid: log-odds that grow with the robot, so that there is no extent to fall out of."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.occupancy import update_grid
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.mapping.config import MapConfig

UNIT = 1 / 500  # Log-odds of one count of the int16 grid: log 4 is 693 counts (0.02 % off), the limit of 50 is 25 000
CHUNK = 256  # The grid grows by whole multiples of this many cells, so that it seldom does
MAX_CELLS = 400_000_000  # A larger grid (at 5 cm, a square kilometre) is a lost robot or an absurd range, and refused


class OccupancyGrid:
    """Log-odds, and beside them which cells count as occupied, kept in step by one kernel."""

    def __init__(self, config: MapConfig) -> None:
        self._config = config
        step, limit, threshold = config.log_odds_step, config.limit, config.occupied_threshold
        counts = {"hit": step, "miss": step, "limit": limit, "threshold": threshold}
        self._counts = {name: round(value / UNIT) for name, value in counts.items()}
        self._scan = 0
        self._corner = np.array([-CHUNK, -CHUNK])  # cell [0, 0] on the lattice of all cells: (column, row)
        self.cell_size = config.cell_size  # [m]
        self.log_odds = np.zeros((2 * CHUNK, 2 * CHUNK), np.int16)  # [H, W] int16 in counts of `UNIT`
        # [H, W] uint8, 1 where the log-odds exceed the threshold; its outermost ring is always 0
        self.occupied = np.zeros((2 * CHUNK, 2 * CHUNK), np.uint8)
        self._seen = np.zeros((2 * CHUNK, 2 * CHUNK), np.int32)

    @property
    def origin(self) -> NDArray[np.float64]:
        """The (x, y) of the corner of cell [0, 0] [m]."""
        return self._corner * self.cell_size

    def add_scan(self, pose: Array, points: ArrayLike, origin: ArrayLike) -> None:
        """Update the cells that one scan measures (III.2): +log 4 at endpoints, -log 4 along the rays to them.

        Endpoints [k, 2] and where the rays start [2] are in the frame of the robot [m], at a pose [3] in the map.

        Raises ``InputError``: the map would grow beyond ``MAX_CELLS``.
        """
        seen = se2.transform_points(pose, np.vstack((np.reshape(origin, (1, 2)), points)))
        cells = np.floor(seen / self.cell_size).astype(np.int64)
        self._grow_to(cells.min(axis=0), cells.max(axis=0))
        cells = (cells - self._corner).astype(np.int32)
        self._scan += 1
        per_ray = self._config.count == "ray"
        options = {**self._counts, "scan": self._scan, "guard": 0 if per_ray else self._config.guard_cells}
        update_grid(self.log_odds, self.occupied, self._seen, cells[0], cells[1:], **options, per_ray=per_ray)

    def forget(self, limit: float) -> None:
        """Keep of every cell at most these log-odds: what newer scans contradict goes, what they do not see stays."""
        most = round(limit / UNIT)
        np.clip(self.log_odds, -most, most, out=self.log_odds)

    def snapshot(self) -> Raster:
        """The map as it stands, cut to the cells that were ever seen: float32 log-odds, 0 unknown, above 0 occupied."""
        seen = self.log_odds != 0
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            rows = columns = np.array([CHUNK])
        top, left = max(rows[0] - 1, 0), max(columns[0] - 1, 0)
        log_odds = self.log_odds[top : rows[-1] + 2, left : columns[-1] + 2].astype(np.float32) * np.float32(UNIT)
        x, y = self.origin + np.array([left, top]) * self.cell_size
        return Raster(log_odds, self.cell_size, (float(x), float(y), 0.0))

    def _grow_to(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> None:
        """Make room for cells from ``low`` to ``high`` (column, row), leaving the outermost ring untouched."""
        height, width = self.log_odds.shape
        size = np.array([width, height])
        below = np.maximum(0, -((low - 1 - self._corner) // CHUNK))
        above = np.maximum(0, (high + 2 - self._corner - size + CHUNK - 1) // CHUNK)
        if not (below.any() or above.any()):
            return
        wide, tall = (int(n) for n in size + (below + above) * CHUNK)
        if wide * tall > MAX_CELLS:
            raise InputError(
                f"the map would grow to {wide * self.cell_size:.0f} x {tall * self.cell_size:.0f} m, expected at most "
                f"{MAX_CELLS:.0e} cells; a larger map.cell_size or a smaller max_range helps",
                field="map.cell_size",
            )
        left, bottom = below * CHUNK
        for name in ("log_odds", "occupied", "_seen"):
            old = getattr(self, name)
            new = np.zeros((tall, wide), old.dtype)
            new[bottom : bottom + height, left : left + width] = old
            setattr(self, name, new)
        self._corner = self._corner - below * CHUNK


def draw_map(config: MapConfig, scans: Scans, indices: list[int], poses: NDArray[np.float64]) -> OccupancyGrid:
    """The occupancy grid of the scans of these indices [u] from known poses [u, 3] of the robot."""
    grid = OccupancyGrid(config)
    for index, pose in zip(indices, poses, strict=True):
        grid.add_scan(pose, scans.points(index), scans.origin)
    return grid
