"""Signed-distance maps of many particles in one pool of tiles, shared until somebody writes (copy on write).

A tile is a square of ``SIDE`` x ``SIDE`` fine cells and, behind them, the same square in cells twice as large. Every
particle has a table of tiles, laid out alike for all of them; entries of particles with a common past name the same
tile. Tile 0 is empty and belongs to nobody. Before a particle writes, it *claims* the tiles: those that are shared
are copied. How many share a tile is a snapshot, taken by counting the tables anew after resampling; so two particles
that claim the same tile at once both make a copy, and nobody writes to what another reads. The numbers of the tiles
depend on the order in which threads claim them; what is in them does not.

A cell is 16 bits: the signed distance to the nearest surface in 1/1023 of the truncation, positive on the side that
the sensor saw it from, and, in the lowest 5 bits, the weight of that average; weight 0 is a cell never seen.
"""

from moteslam.kernels.runtime import ti
from moteslam.kernels.types import F32, I32, func, template

SIDE = 32
"""Fine cells along a tile's edge."""
FINE_CELLS = SIDE * SIDE
CELLS = FINE_CELLS + FINE_CELLS // 4
"""Cells of a tile, both levels."""
STEPS = 1023
"""Steps of distance within the truncation."""
MAX_WEIGHT = 31
"""The largest weight that fits a cell."""


@func
def pack(distance: F32, weight: I32):
    """A cell of a distance in (-1, 1) truncations and a weight."""
    steps = ti.cast(ti.floor(distance * STEPS + 0.5), ti.i32)
    return ti.cast(ti.min(ti.max(steps, -STEPS), STEPS) * 32 + weight, ti.i16)


@func
def address(table: template, base: I32, columns: I32, ix: I32, iy: I32, level: template):
    """Where in the pool the cell (ix, iy) of a level is, for the particle whose table begins at ``base``."""
    shift = ti.static(5 - level)
    mask = ti.static((SIDE >> level) - 1)
    slot = table[base + (iy >> shift) * columns + (ix >> shift)]
    return slot * CELLS + ti.static(FINE_CELLS * level) + ((iy & mask) << shift) + (ix & mask)


@func
def bilinear(pool: template, table: template, base: I32, columns: I32, x: F32, y: F32, level: template):
    """Distance and its gradient at (x, y) [cells of the level]: (d, dd/dx, dd/dy, known), d in truncations.

    The point must lie half a cell or more inside the table. ``known`` is 1 where all four cells around it were seen.
    """
    u, v = x - 0.5, y - 0.5
    ix, iy = ti.cast(ti.floor(u), ti.i32), ti.cast(ti.floor(v), ti.i32)
    fx, fy = u - ti.cast(ix, ti.f32), v - ti.cast(iy, ti.f32)
    mask = ti.static((SIDE >> level) - 1)
    side = ti.static(SIDE >> level)
    a00 = address(table, base, columns, ix, iy, level)
    a10, a01, a11 = a00 + 1, a00 + side, a00 + side + 1
    if (ix & mask) == mask or (iy & mask) == mask:  # the four lie in two or four tiles
        a10 = address(table, base, columns, ix + 1, iy, level)
        a01 = address(table, base, columns, ix, iy + 1, level)
        a11 = address(table, base, columns, ix + 1, iy + 1, level)
    w00, w10 = ti.cast(pool[a00], ti.i32), ti.cast(pool[a10], ti.i32)
    w01, w11 = ti.cast(pool[a01], ti.i32), ti.cast(pool[a11], ti.i32)
    known = ti.min(ti.min(w00 & 31, w10 & 31), ti.min(w01 & 31, w11 & 31)) > 0
    d00, d10 = ti.cast(w00 >> 5, ti.f32), ti.cast(w10 >> 5, ti.f32)
    d01, d11 = ti.cast(w01 >> 5, ti.f32), ti.cast(w11 >> 5, ti.f32)
    low, high = d00 + fx * (d10 - d00), d01 + fx * (d11 - d01)
    scale = ti.f32(1.0 / STEPS)
    dx = ((d10 - d00) * (1 - fy) + (d11 - d01) * fy) * scale
    dy = (high - low) * scale
    return ti.Vector([(low + fy * (high - low)) * scale, dx, dy, ti.cast(known, ti.f32)], dt=ti.f32)


@func
def claim(pool: template, table: template, shares: template, free: template, counters: template, entry: I32):
    """Make the tile of a table's entry the particle's own: copied if shared or empty.

    ``counters`` are how many tiles are free, and whether a claim failed for want of one.
    """
    slot = table[entry]
    if slot == 0 or shares[slot] > 1:
        left = ti.atomic_sub(counters[0], 1)
        if left <= 0:
            counters[1] = 1
        else:
            mine = free[left - 1]
            for c in range(CELLS):
                pool[mine * CELLS + c] = pool[slot * CELLS + c]
            shares[mine] = 1
            table[entry] = mine
