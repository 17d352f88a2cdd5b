"""The score of a pose against a grid: the sum of the cells under a scan seen from there; for ``matching``.

The inner loops have no branch. Beams lie in two contiguous rows and are taken 64 at a time: one loop, which compiles to
vector instructions, finds their cells; a second reads these one by one, since gather instructions are slower than that
on many processors. Beams that leave the grid are clamped to its outermost ring, which must be zero: no test is needed.
The sines and places of the poses are computed in float64 on the host, so that every backend counts the same.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import ti
from moteslam.kernels.types import F32, I32, U32, func, template

BLOCK = 64
"""Beams whose cells are found before the first is read: few enough to unroll and to keep in the fastest cache."""
MAX_BEAMS = 8_000_000
"""255 for each of them fits 31 bits."""


@func
def cell_along(a: F32, b: F32, shift: F32, first: F32, last: F32):
    """The column (or row) of the point a + b + shift [cells], clamped to first..last (whole numbers)."""
    return ti.cast(ti.floor(ti.min(ti.max(a + b + shift, first), last)), ti.i32)


@func
def cell_or_border(along: F32, shift: I32, last: U32):
    """A point's column (or row), shifted, or the last one if it is outside: unsigned, a negative number is large."""
    cell = ti.cast(ti.floor(along), ti.i32) + shift
    return ti.cast(ti.min(ti.cast(cell, ti.u32), last), ti.i32)


@func
def sum_under_scan(
    cells: template, width: I32, height: I32, c: F32, s: F32, x: F32, y: F32, right: I32, up: I32, scan: template,
):  # fmt: skip
    """The sum of the cells under a scan, turned by (c, s), moved to (x, y), then by whole cells (right, up).

    Points more than 2^31 cells below the grid count as outside too: the cast then gives the lowest number.
    """
    last_col, last_row = ti.cast(width - 1, ti.u32), ti.cast(height - 1, ti.u32)
    beams = scan.shape[1]
    total = 0
    under = ti.Vector([0] * BLOCK, dt=ti.i32)
    for block in range(beams // BLOCK):
        for j in range(BLOCK):
            b = block * BLOCK + j
            col = cell_or_border(c * scan[0, b] - s * scan[1, b] + x, right, last_col)
            row = cell_or_border(s * scan[0, b] + c * scan[1, b] + y, up, last_row)
            under[j] = row * width + col
        for j in range(BLOCK):
            # the mask changes nothing, but keeps the compiler from making slow gathers of this loop
            total = (total + ti.cast(cells[under[j]], ti.i32)) & 0x7FFFFFFF
    for b in range(beams // BLOCK * BLOCK, beams):
        col = cell_or_border(c * scan[0, b] - s * scan[1, b] + x, right, last_col)
        row = cell_or_border(s * scan[0, b] + c * scan[1, b] + y, up, last_row)
        total += ti.cast(cells[row * width + col], ti.i32)
    return total


def check_grid(occupied: NDArray[np.uint8]) -> tuple[int, int]:
    """Height and width of a grid, checked: whole words of 8 cells, a border of zeros.

    Raises:
        InputError: it is not that.
    """
    check_array("occupied", occupied, np.uint8, (None, None))
    height, width = occupied.shape
    if width % 8 or not width or height < 2:
        raise InputError(
            f"{height} x {width} cells, expected 2 rows or more, columns a multiple of 8", field="occupied"
        )
    if occupied[0].any() or occupied[-1].any() or occupied[:, 0].any() or occupied[:, -1].any():
        raise InputError("a cell of the outermost ring is not 0, expected a border of zeros", field="occupied")
    return height, width


def words_of(occupied: NDArray[np.uint8]) -> NDArray[np.int32]:
    """The same memory as 32-bit words, the first of four cells in the lowest byte."""
    return occupied.reshape(-1).view(np.dtype("<i4"))


def frames_of(origin: ArrayLike, cell_size: float, poses: ArrayLike) -> NDArray[np.float32]:
    """Poses as the kernels take them: float32 [N, 4] cos, sin, column, row, the latter two in cells."""
    poses = as_finite("poses", poses, np.float64, (None, 3))
    corner = as_finite("origin", origin, np.float64, (2,))
    if not 0 < cell_size < math.inf:
        raise InputError(f"{cell_size}, expected a positive number", field="cell_size")
    frames = np.empty((len(poses), 4), np.float32)
    np.cos(poses[:, 2], out=frames[:, 0], casting="same_kind")
    np.sin(poses[:, 2], out=frames[:, 1], casting="same_kind")
    for axis in (0, 1):
        frames[:, 2 + axis] = (poses[:, axis] - corner[axis]) / cell_size
    return frames


def scan_of(cell_size: float, points: ArrayLike) -> NDArray[np.float32]:
    """Points as the kernels take them: float32 [2, k] x and y in rows, in cells."""
    points = as_finite("points", points, np.float64, (None, 2))
    if len(points) > MAX_BEAMS:
        raise InputError(f"{len(points)}, expected at most {MAX_BEAMS}", field="points")
    scan = np.empty((2, len(points)), np.float32)
    np.divide(points.T, cell_size, out=scan, casting="same_kind")
    return scan
