"""A signed-distance map for every particle: tables of shared tiles that grow with the robot."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.kernels.registration import STEPS, register_scans, search_scans
from moteslam.kernels.surface import ThinScan, add_scans
from moteslam.kernels.tiles import CELLS, SIDE
from moteslam.slam.config import RegistrationConfig, SurfaceConfig

Array = NDArray[np.float64]
TABLE_CHUNK = 8
"""The tables grow by whole multiples of so many tiles."""
FIRST_TILES = 256
MAX_POOL = 2**31 // CELLS
"""Tiles; more would need 64-bit addresses, and 5 GB."""


class SurfaceMaps:
    """The maps of N particles.

    Args:
        config: cell size, truncations, weights.
    """

    def __init__(self, config: SurfaceConfig) -> None:
        self.config = config
        self.tile_size = SIDE * config.cell_size
        self._corner = np.array([-TABLE_CHUNK, -TABLE_CHUNK])  # the first tile of the tables: (column, row)
        self._tables = np.zeros((1, 2 * TABLE_CHUNK, 2 * TABLE_CHUNK), np.int32)
        self._pool = np.zeros(FIRST_TILES * CELLS, np.int16)
        self._count()

    def __len__(self) -> int:
        return len(self._tables)

    @property
    def memory(self) -> int:
        """Bytes taken by tiles and tables."""
        return self._pool.nbytes + self._tables.nbytes

    def all(self) -> MapView:
        """The maps of all particles, to register to."""
        return MapView(self, self._tables)

    def of(self, particle: int) -> MapView:
        """The map of one."""
        return MapView(self, self._tables[particle : particle + 1])

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Give every particle its parent's map."""
        self._tables = self._tables[parents]
        self._count()

    def add(self, poses: Array, scan: ThinScan) -> None:
        """Write a scan into every particle's map, each from its own pose."""
        if len(scan.vertices) < 2:
            return
        c = self.config
        reach = float(np.hypot(*scan.vertices.T).max()) + 2 * c.coarse_truncation + self.tile_size
        self._cover(poses, reach)
        while True:
            left = add_scans(
                self._pool,
                self._tables,
                self._shares,
                self._free[: self._left],
                self.frames(poses),
                scan,
                cell_size=c.cell_size,
                truncation=c.truncation,
                coarse_truncation=c.coarse_truncation,
                sharp=c.sharp,
                sharp_weight=c.sharp_weight,
                max_weight=c.max_weight,
            )
            if left is not None:
                self._left = left
                return
            self._make_room()

    def frames(self, poses: Array) -> Array:
        """Poses as the kernels take them: [N, 4] cos, sin, x, y [m] from the tables' corner."""
        x, y = (poses[:, :2] - self._corner * self.tile_size).T
        return np.stack((np.cos(poses[:, 2]), np.sin(poses[:, 2]), x, y), axis=1)

    def _cover(self, poses: Array, reach: float) -> None:
        """Grow the tables so that everything within ``reach`` [m] of the poses is inside."""
        _, rows, columns = self._tables.shape
        low = np.floor((poses[:, :2].min(axis=0) - reach) / self.tile_size).astype(np.int64)
        high = np.floor((poses[:, :2].max(axis=0) + reach) / self.tile_size).astype(np.int64) + 1
        below = np.maximum(0, -((low - self._corner) // TABLE_CHUNK)) * TABLE_CHUNK
        above = np.maximum(0, -((self._corner + (columns, rows) - high) // TABLE_CHUNK)) * TABLE_CHUNK
        if not below.any() and not above.any():
            return
        wide, tall = (int(v) for v in (columns, rows) + below + above)
        if len(self) * wide * tall >= 2**31:
            raise InputError(
                f"tables of {len(self)} x {wide} x {tall} tiles, expected fewer particles or a smaller max_range",
                field="particles",
            )
        tables = np.zeros((len(self), tall, wide), np.int32)
        tables[:, below[1] : below[1] + rows, below[0] : below[0] + columns] = self._tables
        self._tables = tables
        self._corner = self._corner - below

    def _count(self) -> None:
        """Count anew how many particles share each tile, and which are free."""
        capacity = len(self._pool) // CELLS
        self._shares = np.bincount(self._tables.reshape(-1), minlength=capacity).astype(np.int32)
        self._shares[0] = len(self._tables) + 1  # the empty tile is everybody's: never written, never free
        self._free = np.flatnonzero(self._shares == 0).astype(np.int32)
        self._left = len(self._free)

    def _make_room(self) -> None:
        """After a claim failed: collect the tiles that nobody has any more, and grow the pool if they are few."""
        self._count()
        capacity = len(self._pool) // CELLS
        if 3 * self._left >= capacity:
            return
        if 2 * capacity > MAX_POOL:
            raise InputError(
                f"{capacity} tiles of {len(self)} particles' maps are full, expected fewer particles", field="particles"
            )
        pool = np.zeros(2 * len(self._pool), np.int16)
        pool[: len(self._pool)] = self._pool
        self._pool = pool
        self._count()


class MapView(NamedTuple):
    """The maps of some of the particles.

    Attributes:
        maps: whose they are.
        tables: [n, rows, columns] of the tiles.
    """

    maps: SurfaceMaps
    tables: NDArray[np.int32]

    @property
    def cell_size(self) -> float:
        """Of the fine level [m]."""
        return self.maps.config.cell_size

    def register(
        self,
        poses: Array,
        points: NDArray[np.float32],
        origin: Array,
        starts: Array,
        priors: Array,
        config: RegistrationConfig,
        unknown=2.0,
        outlier=8.0,
    ) -> tuple[Array, Array]:
        """See ``register_scans``."""
        c = self.maps.config
        return register_scans(
            self.maps._pool,
            self.tables,
            self.maps.frames(poses),
            points,
            origin,
            starts,
            priors,
            cell_size=c.cell_size,
            truncation=c.truncation,
            coarse_truncation=c.coarse_truncation,
            residual=config.residual,
            iterations=config.iterations,
            unknown=unknown,
            outlier=outlier,
        )

    def search(
        self,
        poses: Array,
        points: NDArray[np.float32],
        turns: Array,
        turn_costs: Array,
        shifts: Array,
        shift_costs: Array,
        blocks: int,
        sharp: float = 0.2,
    ):
        """See ``search_scans``; costs in truncations."""
        return search_scans(
            self.maps._pool,
            self.tables,
            self.maps.frames(poses),
            points,
            turns,
            turn_costs * STEPS,
            shifts,
            shift_costs * STEPS,
            blocks=blocks,
            cell_size=2 * self.cell_size,
            sharp=sharp / self.maps.config.coarse_truncation,
        )
