"""Pools of tiles to try the signed-distance kernels on, and scans of a room to integrate into them."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from box_ranges import box_ranges
from numpy.typing import ArrayLike, NDArray
from twins.tsdf import Tsdf

from moteslam.kernels.scans import ThinnedScan
from moteslam.kernels.tiles import CELLS, FINE_CELLS, MAX_WEIGHT, SIDE, WEIGHT_BITS, Tiles, TileStore
from moteslam.kernels.tsdf import IntegrationOptions

CELL = 0.05
TRUNCATION, COARSE_TRUNCATION = 0.15, 0.4
OPTIONS = {
    "cell_size": CELL, "truncation": TRUNCATION, "coarse_truncation": COARSE_TRUNCATION,
    "coarse_chord": 0.5, "near": 0.06, "near_weight": 8, "max_weight": MAX_WEIGHT,
}  # fmt: skip
REGISTRATION = {
    "cell_size": CELL, "truncation": TRUNCATION, "coarse_truncation": COARSE_TRUNCATION, "residual": 0.01,
    "coarse_residual_factor": 1.7, "iterations": 8, "unknown_cost": 2.0, "outlier_cost": 8.0, "likelihood_width": 2.5,
    "ray_clearance": 1.8, "ray_weight": 3, "ray_distance": 0.4, "far": 0.3,
}  # fmt: skip
ROOM = (8.0, 6.0)
MIDDLE = np.array((8.0, 7.2, 0.0))  # Of the room, where `room_scan` has it, from the corner of tables of 10 x 9 tiles


def tiles_of(pool: NDArray[np.int16], tables: NDArray[np.int32]) -> Tiles:
    """The maps in a pool [t * CELLS] of t tiles and tables [n, rows, columns] of these."""
    n, rows, columns = tables.shape
    return Tiles(pool, tables.reshape(-1), rows, columns, n)


@dataclass
class Pool:
    """What ``integrate_scans`` works on: see there."""

    pool: NDArray[np.int16]
    tables: NDArray[np.int32]
    shares: NDArray[np.int32]
    free: NDArray[np.int32]

    @classmethod
    def empty(cls, particles: int = 1, *, rows: int = 9, columns: int = 10, tiles: int = 200) -> Self:
        return cls._counted(np.zeros(tiles * CELLS, np.int16), np.zeros((particles, rows, columns), np.int32))

    @classmethod
    def _counted(cls, pool: NDArray[np.int16], tables: NDArray[np.int32]) -> Self:
        shares = np.bincount(tables.reshape(-1), minlength=len(pool) // CELLS).astype(np.int32)
        shares[0] = len(tables) + 1
        return cls(pool, tables, shares, np.flatnonzero(shares == 0).astype(np.int32))

    def resampled(self, parents: ArrayLike, *, more_tiles: int = 0) -> Self:
        """The particles' children, the shares counted again, in a pool of their own."""
        pool = np.concatenate((self.pool, np.zeros(more_tiles * CELLS, np.int16)))
        return self._counted(pool, self.tables[np.asarray(parents)])

    @property
    def tiles(self) -> Tiles:
        """Of all particles, as kernels take them."""
        return tiles_of(self.pool, self.tables)

    def add(self, poses: ArrayLike, scan: ThinnedScan, **options: Any) -> int | None:
        """``integrate_scans`` for all particles; tiles that were taken are no longer free."""
        from moteslam.kernels.tsdf import integrate_scans

        store = self.store()
        given = IntegrationOptions(**(OPTIONS | options))  # type: ignore[arg-type]
        enough = integrate_scans(store, frames(poses), [scan], options=given)
        self.free = self.free[: store.left if enough else 0]
        return store.left if enough else None

    def store(self) -> TileStore:
        """Of all particles, in the same arrays."""
        store = TileStore(1, 1, 1)
        store.tiles = self.tiles
        store.shares, store.free, store.left = self.shares, self.free, len(self.free)
        return store

    def words(self, particle: int = 0, level: int = 0) -> NDArray[np.int16]:
        """All cells of a particle's level, [H, W]."""
        side = SIDE >> level
        tiles = self.pool.reshape(-1, CELLS)[self.tables[particle]]
        cells = tiles[..., FINE_CELLS * level : FINE_CELLS * level + side * side]
        rows, columns = self.tables.shape[1:]
        return cells.reshape(rows, columns, side, side).swapaxes(1, 2).reshape(rows * side, columns * side)

    def tsdf(self, particle: int = 0, level: int = 0) -> Tsdf:
        """The same for the twins."""
        words = self.words(particle, level).astype(np.int64)
        return Tsdf(words >> WEIGHT_BITS, words & MAX_WEIGHT)

    def all_words(self) -> NDArray[np.int16]:
        """All cells of all particles, fine and coarse, whatever the numbers of their tiles."""
        return np.stack(
            [np.concatenate([self.words(i, level).reshape(-1) for level in (0, 1)]) for i in range(len(self.tables))]
        )


def frames(poses: ArrayLike) -> NDArray[np.float64]:
    """Poses [n, 3] from the tables' corner as the kernels take them."""
    x, y, theta = np.asarray(poses, np.float64).T
    return np.stack((np.cos(theta), np.sin(theta), x, y), axis=1)


def room_scan(pose: ArrayLike = (0.0, 0.0, 0.0), *, beams: int = 360) -> NDArray[np.float32]:
    """The endpoints [beams, 2] on the walls of a room, all around, from a pose given from its middle."""
    x, y, theta = np.asarray(pose, np.float64)
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False) + 0.001
    corner = ROOM[0] / 2, ROOM[1] / 2
    ranges = box_ranges(x, y, angles + theta, (-corner[0], -corner[1]), corner)
    return (ranges[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)).astype(np.float32)


def thinned(points: ArrayLike, **options: float) -> ThinnedScan:
    """A scan from its own origin, as the kernels take it."""
    from moteslam.kernels.scans import thin_scan

    return thin_scan(points, (0.0, 0.0), **({"spacing": 0.02, "gap": 0.3, "gap_from_range": 0.05} | options))


def moved(pose: ArrayLike, offset: ArrayLike) -> NDArray[np.float64]:
    """The pose moved by an offset in its frame."""
    (x, y, theta), (dx, dy, turn) = np.asarray(pose, float), np.asarray(offset, float)
    return np.array(
        (x + np.cos(theta) * dx - np.sin(theta) * dy, y + np.sin(theta) * dx + np.cos(theta) * dy, theta + turn)
    )


def mapped_room() -> Pool:
    """The map of one scan from the middle of the room."""
    from moteslam.kernels.runtime import runtime

    runtime()
    pool = Pool.empty()
    assert pool.add([MIDDLE], thinned(room_scan(beams=720))) is not None
    return pool
