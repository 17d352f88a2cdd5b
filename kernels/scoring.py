"""Scoring poses against a grid: how much of a scan falls on occupied cells when seen from each pose.

Built for the vector unit, which is half of the speed (measured in benchmarks/): no branch in the inner loop, beams in
two contiguous rows, cells read as 32-bit words of four, an integer sum. Beams that leave the grid are clamped to its
outermost ring, which must be zero; so clamping replaces the test. What depends on the pose alone is computed in
float64 on the host, so that every backend rounds the same way and counts the same.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.types import F32, F32_2D, I32, I32_1D, func, kernel


@func
def cell_along(a: F32, b: F32, shift: F32, first: F32, last: F32):
    """The column (or row) of the point a + b + shift [cells], clamped to first..last (whole numbers)."""
    return ti.cast(ti.floor(ti.min(ti.max(a + b + shift, first), last)), ti.i32)


@kernel
def _score_poses(words: I32_1D, width: I32, height: I32, frames: F32_2D, scan: F32_2D, out: I32_1D):
    for i in range(frames.shape[0]):
        c, s, x, y = frames[i, 0], frames[i, 1], frames[i, 2], frames[i, 3]
        total = 0
        for b in range(scan.shape[1]):
            # the cast truncates where floor is meant: they differ left of the grid alone, where both read the border
            col = ti.cast(c * scan[0, b] - s * scan[1, b] + x, ti.i32)
            row = ti.cast(s * scan[0, b] + c * scan[1, b] + y, ti.i32)
            cell = ti.min(ti.max(row, 0), height - 1) * width + ti.min(ti.max(col, 0), width - 1)
            total += (words[cell >> 2] >> ((cell & 3) << 3)) & 255
        out[i] = total


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
    height, width = check_grid(occupied)
    frames, scan = frames_of(origin, cell_size, poses), scan_of(cell_size, points)
    if out is None:
        out = np.empty(len(frames), np.int32)
    check_array("out", out, np.int32, (len(frames),), written=True)
    runtime()
    if len(frames):
        _score_poses(words_of(occupied), width, height, frames, scan, out)
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
    x, y = as_finite("origin", origin, np.float64, (2,))
    if not (np.isfinite(cell_size) and cell_size > 0):
        raise InputError(f"{cell_size}, expected a positive number", field="cell_size")
    frames = np.empty((len(poses), 4), np.float32)
    frames[:, 0], frames[:, 1] = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    frames[:, 2] = (poses[:, 0] - x) / cell_size
    frames[:, 3] = (poses[:, 1] - y) / cell_size
    return frames


def scan_of(cell_size: float, points: ArrayLike) -> NDArray[np.float32]:
    """Points as the kernels take them: float32 [2, k] x and y in rows, in cells."""
    points = as_finite("points", points, np.float64, (None, 2))
    scan = np.empty((2, len(points)), np.float32)
    np.divide(points.T, cell_size, out=scan, casting="same_kind")
    return scan
