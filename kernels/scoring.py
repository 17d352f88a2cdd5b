"""Scoring poses against a grid: how much of a scan falls on occupied cells when seen from each pose.

Built for what compilers and processors do well (measured in benchmarks/). There is no branch in the inner loops.
Beams lie in two contiguous rows and are taken 64 at a time: one loop, which becomes vector instructions, finds their
cells; a second reads these one by one, for gather instructions are slower than that on many processors. Beams that
leave the grid are clamped to its outermost ring, which must be zero; so clamping replaces the test. What depends on
the pose alone is computed in float64 on the host, so that every backend rounds the same way and counts the same.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.types import F32, F32_2D, I32, I32_1D, U8_1D, U32, func, kernel, template

BLOCK = 64
"""Beams whose cells are found before the first is read: as many as are unrolled and kept in the fastest cache."""
MAX_BEAMS = 8_000_000
"""255 for each of them fits 31 bits."""


@func
def cell_along(a: F32, b: F32, shift: F32, first: F32, last: F32):
    """The column (or row) of the point a + b + shift [cells], clamped to first..last (whole numbers)."""
    return ti.cast(ti.floor(ti.min(ti.max(a + b + shift, first), last)), ti.i32)


@func
def cell_or_border(along: F32, shift: I32, last: U32, shifted: template):
    """A point's column (or row), shifted, or the last one if it is outside: as an unsigned number, below 0 is huge."""
    cell = ti.cast(along, ti.i32)  # truncates; not the floor only between -1 and 0, where both read the border...
    if ti.static(shifted):
        cell = ti.cast(ti.floor(along), ti.i32) + shift  # ... unless the cell is shifted from there
    return ti.cast(ti.min(ti.cast(cell, ti.u32), last), ti.i32)


@func
def sum_under_scan(
    cells: template, width: I32, height: I32, c: F32, s: F32, x: F32, y: F32, right: I32, up: I32, shifted: template,
    scan: template,
):  # fmt: skip
    """The sum of the cells under a scan, turned by (c, s), moved to (x, y), and if shifted by whole cells (right, up).

    What is below the grid by more than 2^31 cells counts as outside too: the cast then gives the lowest number.
    """
    last_col, last_row = ti.cast(width - 1, ti.u32), ti.cast(height - 1, ti.u32)
    beams = scan.shape[1]
    total = 0
    under = ti.Vector([0] * BLOCK, dt=ti.i32)
    for block in range(beams // BLOCK):
        for j in range(BLOCK):
            b = block * BLOCK + j
            col = cell_or_border(c * scan[0, b] - s * scan[1, b] + x, right, last_col, shifted)
            row = cell_or_border(s * scan[0, b] + c * scan[1, b] + y, up, last_row, shifted)
            under[j] = row * width + col
        for j in range(BLOCK):
            # the mask changes nothing, but keeps the compiler from making slow gathers of this loop
            total = (total + ti.cast(cells[under[j]], ti.i32)) & 0x7FFFFFFF
    for b in range(beams // BLOCK * BLOCK, beams):
        col = cell_or_border(c * scan[0, b] - s * scan[1, b] + x, right, last_col, shifted)
        row = cell_or_border(s * scan[0, b] + c * scan[1, b] + y, up, last_row, shifted)
        total += ti.cast(cells[row * width + col], ti.i32)
    return total


@kernel
def _score_poses(cells: U8_1D, width: I32, height: I32, frames: F32_2D, scan: F32_2D, out: I32_1D):
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(frames.shape[0]):
        out[i] = sum_under_scan(
            cells, width, height, frames[i, 0], frames[i, 1], frames[i, 2], frames[i, 3], 0, 0, False, scan
        )


def score_poses(
    occupied: NDArray[np.uint8],
    origin: ArrayLike,
    cell_size: float,
    poses: ArrayLike,
    points: ArrayLike,
    *,
    out: NDArray[np.int32] | None = None,
) -> NDArray[np.int32]:
    """The sum over a scan's points of the cell under each, seen from each pose (section III.D.2 of the paper).

    Points beyond the grid count zero. A point is in the cell ``floor((x - origin) / cell_size)``, in float32.

    Args:
        occupied: uint8 [H, W], W a multiple of 8; the outermost ring of cells must be zero. 0 and 1 count points
            on occupied cells; other values up to 255 weigh them.
        origin: [2] (x, y) of the corner of cell [0, 0] [m].
        cell_size: [m].
        poses: [N, 3].
        points: [k, 2] in the frame of each pose [m].
        out: int32 [N] to write to.

    Returns:
        int32 [N]; ``out`` if given.

    Raises:
        InputError: arrays that do not fit, values that are not finite, or an outermost ring that is not zero.
    """
    check_grid(occupied)
    frames, scan = frames_of(origin, cell_size, poses), scan_of(cell_size, points)
    if out is None:
        out = np.empty(len(frames), np.int32)
    return score_frames(occupied, frames, scan, out=out)


def score_frames(
    occupied: NDArray[np.uint8], frames: NDArray[np.float32], scan: NDArray[np.float32], *, out: NDArray[np.int32]
) -> NDArray[np.int32]:
    """``score_poses`` without its preparations, for who scores the same poses or the same scan more than once.

    Args:
        occupied: as for ``score_poses``; whether its border is zero is not looked at.
        frames: float32 [N, 4] of ``frames_of``.
        scan: float32 [2, k] of ``scan_of``.
        out: int32 [N] to write to.

    Returns:
        ``out``.

    Raises:
        InputError: an array of another type or shape.
    """
    check_array("occupied", occupied, np.uint8, (None, None))
    check_array("frames", frames, np.float32, (None, 4))
    check_array("scan", scan, np.float32, (2, None))
    check_array("out", out, np.int32, (len(frames),), written=True)
    height, width = occupied.shape
    runtime()
    if len(frames):
        _score_poses(occupied.reshape(-1), width, height, frames, scan, out)
    return out


def check_grid(occupied: NDArray[np.uint8]) -> tuple[int, int]:
    """Height and width of a grid that the kernels can read: whole words, a zero border.

    Raises:
        InputError: it is none.
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
