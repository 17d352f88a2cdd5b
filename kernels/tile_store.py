"""Where the tiles of many maps are kept: in NumPy's memory for kernels on the processor, in a GPU's for those there.

A kernel on the processor reads and writes NumPy's memory as it is. To a GPU such an array is copied for every launch,
and back: maps of many megabytes stay on the device instead, and only tables come to the host, when they change.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.tiles import CELLS, EMPTY, Tiles
from moteslam.kernels.types import I16_1D, kernel


@kernel
def _copy(pool: I16_1D, into: I16_1D):
    ti.loop_config(serialize=ti.static(one_thread()))
    for k in range(pool.shape[0]):
        into[k] = pool[k]


class TileStore:
    """The tiles and tables of n maps, one at first and empty.

    Args:
        rows, columns: of a table.
        tiles: there is room for.
        on_device: in Taichi's memory, else in NumPy's.

    Attributes:
        tiles: the maps.
        shares: int32 [t] how many table entries name each tile, above 1 for tile 0, as of the last ``count``.
        free: int32 [t] of which the first ``left`` are tiles that no table names and no kernel has taken since.
        left: how many.
    """

    def __init__(self, rows: int, columns: int, tiles: int, *, on_device: bool = False) -> None:
        self._on_device = on_device
        self.tiles = Tiles(self._room(tiles), self._put(np.zeros(rows * columns, np.int32)), rows, columns, maps=1)
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
        table = self._tables()[parents].reshape(-1)
        self.tiles = self.tiles._replace(table=self._put(table), maps=len(parents))
        self.count()

    def grow(self, rows: int, columns: int, up: int, right: int) -> None:
        """Tables of this size, in which the old ones lie ``up`` rows and ``right`` columns from the first entry."""
        t = self.tiles
        tables = np.full((t.maps, rows, columns), EMPTY, np.int32)
        tables[:, up : up + t.rows, right : right + t.columns] = self._tables().reshape(t.maps, t.rows, t.columns)
        self.tiles = t._replace(table=self._put(tables.reshape(-1)), rows=rows, columns=columns)

    def enlarge(self) -> None:
        """Twice the room for tiles."""
        pool, old = self._room(2 * self.capacity), self.tiles.pool
        if self._on_device:
            _copy(old, pool)
        else:
            pool[: len(old)] = old
        self.tiles = self.tiles._replace(pool=pool)
        self.count()

    def count(self) -> None:
        """Count anew how many tables name each tile, and which tiles are free."""
        table = self._tables()
        # without the empty tile, which most entries name: in a fifth of the time
        shares = np.bincount(table[table != EMPTY], minlength=self.capacity).astype(np.int32)
        shares[EMPTY] = self.tiles.maps + 1  # everybody's: never written, never free
        free = np.flatnonzero(shares == 0).astype(np.int32)
        self.left = len(free)
        self.shares, self.free = self._put(shares), self._put(free if self.left else np.zeros(1, np.int32))

    def _tables(self) -> NDArray[np.int32]:
        """The tables [n, rows * columns] on the host."""
        table: Any = self.tiles.table
        tables: NDArray[np.int32] = table.to_numpy() if self._on_device else table
        return tables.reshape(self.tiles.maps, -1)

    def _put(self, array: NDArray[np.int32]) -> Any:
        """An array where the kernels read it."""
        if not self._on_device:
            return array
        there = ti.ndarray(ti.i32, len(array))
        there.from_numpy(array)
        return there

    def _room(self, tiles: int) -> Any:
        """Zeros for so many tiles."""
        if not self._on_device:
            return np.zeros(tiles * CELLS, np.int16)  # takes no memory until it is written to
        runtime()
        return ti.ndarray(ti.i16, tiles * CELLS)


def tile_store(rows: int, columns: int, tiles: int) -> TileStore:
    """A store where the kernels of this process run; arguments as of ``TileStore``."""
    return TileStore(rows, columns, tiles, on_device=runtime().arch == "cuda")
