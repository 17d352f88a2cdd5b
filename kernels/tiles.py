"""Signed-distance maps of many particles in one pool of tiles, shared until a particle writes (copy on write).

A tile is a square of ``SIDE`` x ``SIDE`` fine cells (level 0) and, behind them, the same square in cells twice as large
(level 1). Every particle has a table of tiles, laid out alike for all of them; entries of particles with a common past
name the same tile. Tile 0 is empty and belongs to nobody. Before a particle writes, it copies the tiles that it shares.
How many particles share a tile is a snapshot, taken by counting the tables after resampling: two particles that write
to the same tile at once both make a copy, and nobody writes to what another reads. The numbers of the tiles depend on
the order in which threads copy them; what is in them does not.

A cell is 16 bits: the signed distance to the nearest surface in ``1/STEPS`` of the truncation and, in the lowest bits,
the weight of that average; weight 0 is a cell never seen. Distances are positive on the left of a surface, as the scan
runs along it: where beams go counterclockwise, on the side that the sensor saw it from.

A kernel on the processor reads and writes NumPy's memory as it is. To a GPU such an array is copied for every launch,
and back: there maps of many megabytes stay on the device, and come to the host only when tables change.

Written by hand, since no library has copy-on-write tiles that Taichi kernels can read and write.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.types import F32, I32, func, template

SIDE_BITS = 5
SIDE = 1 << SIDE_BITS  # Fine cells along a tile's edge
FINE_CELLS = SIDE * SIDE
CELLS = FINE_CELLS + FINE_CELLS // 4  # Cells of a tile, both levels
EMPTY = 0  # The number of the tile that stands for none
WEIGHT_BITS = 5
MAX_WEIGHT = (1 << WEIGHT_BITS) - 1  # The largest weight that fits a cell
STEPS = (1 << (15 - WEIGHT_BITS)) - 1  # Steps of distance within the truncation


class Tiles(NamedTuple):
    """The maps of n particles as kernels take them, of a ``TileStore``."""

    pool: NDArray[np.int16]  # int16 [t * CELLS] of all tiles
    table: NDArray[np.int32]  # int32 the particles' tables, one after the other, row by row: tiles 0 to t - 1
    rows: int  # of each table
    columns: int  # likewise
    maps: int  # n
    first: int = 0  # where in `table` that of the first particle begins

    @property
    def size(self) -> int:
        """Tiles of a table: from one particle's to the next."""
        return self.rows * self.columns

    def of(self, particle: int) -> "Tiles":
        return Tiles(self.pool, self.table, self.rows, self.columns, 1, self.first + particle * self.size)


@func
def pack(distance: F32, weight: I32):
    """A cell of a distance in (-1, 1) truncations and a weight."""
    steps = ti.cast(ti.floor(distance * STEPS + 0.5), ti.i32)
    return ti.cast(ti.min(ti.max(steps, -STEPS), STEPS) * (1 << WEIGHT_BITS) + weight, ti.i16)


@func
def steps_of(word):
    """The distance in a cell, or in each of a vector of cells, in steps: ``STEPS`` are one truncation."""
    return word >> WEIGHT_BITS


@func
def weight_of(word):
    """The weight in a cell, or in each of a vector of cells; 0 is never seen."""
    return word & MAX_WEIGHT


@func
def tile_along(place: F32):
    """The column, or row, of the tile over a place [fine cells]."""
    return ti.cast(ti.floor(place), ti.i32) >> SIDE_BITS


@func
def address(table: template, base: I32, columns: I32, ix: I32, iy: I32, level: template):
    """Where in the pool the cell (ix, iy) of a level is, for the particle whose table begins at ``base``."""
    shift = ti.static(SIDE_BITS - level)
    mask = ti.static((SIDE >> level) - 1)
    slot = table[base + (iy >> shift) * columns + (ix >> shift)]
    return slot * CELLS + ti.static(FINE_CELLS * level) + ((iy & mask) << shift) + (ix & mask)


@func
def read(
    pool: template, table: template, base: I32, columns: I32, x: F32, y: F32, last_x: F32, last_y: F32, level: template
):
    """The cell under (x, y) [cells of the level], moved to where the level has cells: 0 to ``last``."""
    ix, iy = ti.cast(ti.min(ti.max(x, 0.0), last_x), ti.i32), ti.cast(ti.min(ti.max(y, 0.0), last_y), ti.i32)
    return ti.cast(pool[address(table, base, columns, ix, iy, level)], ti.i32)


@func
def bilinear(pool: template, table: template, base: I32, columns: I32, x: F32, y: F32, level: template):
    """Distance and its gradient at (x, y) [cells of the level]: (d, dd/dx, dd/dy, known), d in steps.

    The point must lie half a cell or more inside the table. ``known`` is 1 where all four cells around it were seen.
    """
    u, v = x - 0.5, y - 0.5
    ix, iy = ti.cast(u, ti.i32), ti.cast(v, ti.i32)  # positive numbers: the cast is the floor
    fx, fy = u - ti.cast(ix, ti.f32), v - ti.cast(iy, ti.f32)
    mask = ti.static((SIDE >> level) - 1)
    side = ti.static(SIDE >> level)
    a00 = address(table, base, columns, ix, iy, level)
    a10, a01, a11 = a00 + 1, a00 + side, a00 + side + 1
    if (ix & mask) == mask or (iy & mask) == mask:  # the four lie in two or four tiles
        a10 = address(table, base, columns, ix + 1, iy, level)
        a01 = address(table, base, columns, ix, iy + 1, level)
        a11 = address(table, base, columns, ix + 1, iy + 1, level)
    words = ti.cast(ti.Vector([pool[a00], pool[a10], pool[a01], pool[a11]], dt=ti.i16), ti.i32)
    weights, d = weight_of(words), ti.cast(steps_of(words), ti.f32)
    least = ti.min(ti.min(weights[0], weights[1]), ti.min(weights[2], weights[3]))
    below, above = d[1] - d[0], d[3] - d[2]
    low, high = d[0] + fx * below, d[2] + fx * above
    dx, dy = below + fy * (above - below), high - low
    return ti.Vector([low + fy * dy, dx, dy, ti.cast(least > 0, ti.f32)], dt=ti.f32)


@func
def copy_on_write(pool: template, table: template, shares: template, free: template, counters: template, entry: I32):
    """Make the tile of a table's entry the particle's own: copied if shared or empty.

    ``counters`` are how many tiles are free, below 0 by those that were missing, and whether any was: then the entry is
    as it was.
    """
    slot = table[entry]
    if slot == EMPTY or shares[slot] > 1:
        left = ti.atomic_sub(counters[0], 1)
        if left <= 0:
            counters[1] = 1
        else:
            mine = free[left - 1]
            for c in range(CELLS):
                pool[mine * CELLS + c] = pool[slot * CELLS + c]
            shares[mine] = 1
            table[entry] = mine


class TileStore:
    """The tiles and tables of n maps, one at first and empty.

    Args:
        rows, columns: of a table.
        tiles: there is room for.
        on_device: in Taichi's memory, else in NumPy's.

    Attributes:
        tiles: the maps.
    """

    def __init__(self, rows: int, columns: int, tiles: int, *, on_device: bool = False) -> None:
        self._on_device = on_device
        pool, table = self._put(np.zeros(tiles * CELLS, np.int16)), self._put(np.zeros(rows * columns, np.int32))
        self.tiles = Tiles(pool, table, rows, columns, 1)
        self.shares: Any  # int32 [t] how many table entries name each tile, above 1 for tile 0, as of the last `count`
        self.free: Any  # int32 [t] of which the first `left` are tiles that no table names and no kernel took since
        self.left = 0  # how many
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

    def fill(self, pool: NDArray[np.int16], table: NDArray[np.int32]) -> None:
        """One map of these tiles; arguments as of ``Tiles``."""
        self.tiles = self.tiles._replace(pool=self._put(pool), table=self._put(table), maps=1)
        self.count()

    def enlarge(self) -> None:
        """Twice the room for tiles."""
        pool = np.zeros(2 * self.capacity * CELLS, np.int16)  # takes no memory until it is written to
        pool[: len(pool) // 2] = self._host(self.tiles.pool)
        self.tiles = self.tiles._replace(pool=self._put(pool))
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
        return self._host(self.tiles.table).reshape(self.tiles.maps, -1)

    def _host(self, array: Any) -> NDArray[Any]:
        here: NDArray[Any] = array.to_numpy() if self._on_device else array
        return here

    def _put(self, array: NDArray[Any]) -> Any:
        """An array where the kernels read it."""
        if not self._on_device:
            return array
        runtime()
        there = ti.ndarray(ti.i16 if array.dtype == np.int16 else ti.i32, len(array))
        there.from_numpy(array)
        return there


def tile_store(rows: int, columns: int, tiles: int) -> TileStore:
    """A store where the kernels of this process run; arguments as of ``TileStore``."""
    return TileStore(rows, columns, tiles, on_device=runtime().arch == "cuda")
