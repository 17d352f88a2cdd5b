"""Where the tiles of many maps are kept: in NumPy's memory for kernels on the processor, in a GPU's for those there.

A kernel on the processor reads and writes NumPy's memory as it is. To a GPU such an array is copied for every launch,
and back: maps of many megabytes, which only kernels read and write, stay on the device instead (``DeviceTileStore``).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.tiles import CELLS, EMPTY, Tiles
from moteslam.kernels.types import I16_1D, I32, I32_1D, kernel


class TileStore:
    """The tiles and tables of n maps, one at first, in NumPy's memory.

    Attributes:
        tiles: the maps.
        shares: int32 [t] how many table entries name each tile, above 1 for tile 0, as of the last ``count``.
        free: int32 [f] of which the first ``left`` are tiles that no table names and no kernel has taken since.
        left: how many.
    """

    def __init__(self, rows: int, columns: int, tiles: int) -> None:
        pool, table = self._zeros(tiles * CELLS, np.int16), self._zeros(rows * columns, np.int32)
        self.tiles = Tiles(pool, table, rows, columns, maps=1)
        self.shares: Any
        self.free: Any
        self.left = 0
        self.count()

    @property
    def capacity(self) -> int:
        """Tiles that the pool has room for."""
        return int(self.tiles.pool.shape[0]) // CELLS

    @property
    def nbytes(self) -> int:
        """Memory of tiles and tables."""
        return 2 * int(self.tiles.pool.shape[0]) + 4 * int(self.tiles.table.shape[0])

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Give map i the table of map ``parents[i]``; there are as many as parents from now on."""
        t = self.tiles
        self.tiles = t._replace(table=self._resampled(parents), maps=len(parents))
        self.count()

    def grow(self, rows: int, columns: int, up: int, right: int) -> None:
        """Tables of this size, in which the old ones lie ``up`` rows and ``right`` columns from the first entry."""
        self.tiles = self.tiles._replace(table=self._grown(rows, columns, up, right), rows=rows, columns=columns)

    def enlarge(self) -> None:
        """Twice the room for tiles."""
        self.tiles = self.tiles._replace(pool=self._enlarged())
        self.count()

    def count(self) -> None:
        """Count anew how many tables name each tile, and which tiles are free."""
        t = self.tiles
        # without the empty tile, which most entries name: in a fifth of the time
        shares = np.bincount(t.table[t.table != EMPTY], minlength=self.capacity).astype(np.int32)
        shares[EMPTY] = t.maps + 1  # everybody's: never written, never free
        self.shares, self.free = shares, np.flatnonzero(shares == 0).astype(np.int32)
        self.left = len(self.free)

    def _zeros(self, length: int, dtype: Any) -> Any:
        return np.zeros(length, dtype)

    def _resampled(self, parents: NDArray[np.int64]) -> Any:
        return self.tiles.table.reshape(self.tiles.maps, -1)[parents].reshape(-1)

    def _grown(self, rows: int, columns: int, up: int, right: int) -> Any:
        t = self.tiles
        tables = np.full((t.maps, rows, columns), EMPTY, np.int32)
        tables[:, up : up + t.rows, right : right + t.columns] = t.table.reshape(t.maps, t.rows, t.columns)
        return tables.reshape(-1)

    def _enlarged(self) -> Any:
        pool = np.zeros(2 * len(self.tiles.pool), np.int16)  # takes no memory until it is written to
        pool[: len(self.tiles.pool)] = self.tiles.pool
        return pool


@kernel
def _resample(table: I32_1D, size: I32, parents: I32_1D, into: I32_1D):
    """The tables of the parents, ``size`` entries each."""
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(into.shape[0]):
        into[k] = table[parents[k // size] * size + k % size]


@kernel
def _grow(table: I32_1D, rows: I32, columns: I32, tall: I32, wide: I32, up: I32, right: I32, into: I32_1D):
    """Tables of ``rows`` x ``columns`` entries written into larger ones, from row ``up`` and column ``right`` on."""
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(table.shape[0]):
        i, row, column = k // (rows * columns), k // columns % rows, k % columns
        into[(i * tall + row + up) * wide + column + right] = table[k]


@kernel
def _copy(pool: I16_1D, into: I16_1D):
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(pool.shape[0]):
        into[k] = pool[k]


@kernel
def _count(table: I32_1D, maps: I32, shares: I32_1D, free: I32_1D, left: I32_1D):
    """The shares of all tiles, and those of share 0: ``left[0]`` of them, in any order."""
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(shares.shape[0]):
        shares[k] = ti.select(k == EMPTY, maps + 1, 0)
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(table.shape[0]):
        if table[k] != EMPTY:
            ti.atomic_add(shares[table[k]], 1)
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(shares.shape[0]):
        if shares[k] == 0:
            free[ti.atomic_add(left[0], 1)] = k


class DeviceTileStore(TileStore):
    """The same where kernels run: on a GPU nothing but the number of free tiles comes back to the host.

    Which tiles particles get depends on the order of threads; what is in them does not.
    """

    def count(self) -> None:
        """See ``TileStore``."""
        if not hasattr(self, "shares") or self.shares.shape[0] != self.capacity:
            self.shares, self.free = self._zeros(self.capacity, np.int32), self._zeros(self.capacity, np.int32)
        left = np.zeros(1, np.int32)
        _count(self.tiles.table, self.tiles.maps, self.shares, self.free, left)
        self.left = int(left[0])

    def _zeros(self, length: int, dtype: Any) -> Any:
        runtime()
        return ti.ndarray(ti.i16 if dtype is np.int16 else ti.i32, length)

    def _resampled(self, parents: NDArray[np.int64]) -> Any:
        into = self._zeros(len(parents) * self.tiles.size, np.int32)
        _resample(self.tiles.table, self.tiles.size, np.ascontiguousarray(parents, np.int32), into)
        return into

    def _grown(self, rows: int, columns: int, up: int, right: int) -> Any:
        t = self.tiles
        into = self._zeros(t.maps * rows * columns, np.int32)
        _grow(t.table, t.rows, t.columns, rows, columns, up, right, into)
        return into

    def _enlarged(self) -> Any:
        into = self._zeros(2 * int(self.tiles.pool.shape[0]), np.int16)
        _copy(self.tiles.pool, into)
        return into


def tile_store(rows: int, columns: int, tiles: int) -> TileStore:
    """A store of one empty map where the kernels of this process run; arguments as of ``TileStore``."""
    return (DeviceTileStore if runtime().arch == "cuda" else TileStore)(rows, columns, tiles)
