"""Matching by exhaustive search: the best pose of a small lattice around each particle (the paper's 5 x 5 x 5).

Where the offsets in x and y are whole cells and span at most 5 x 5 of them, the scan is rotated and looked up once for
each heading, a shift of the pose is a shift of the cells, and one 64-bit word holds every cell that a point can meet:
the map is first rewritten as overlapping windows of 8 x 8 cells, one bit each, every 4 cells; then each point takes one
load for all 25 shifts, and the counts of five rows are added up side by side in the bytes of five words (measured:
benchmarks/).

The inner loops have no branch. Beams lie in two contiguous rows and are taken 64 at a time: one loop, which compiles to
vector instructions, finds their cells; a second reads these one by one, since gather instructions are slower than that
on many processors. Beams that leave the grid are clamped to its outermost ring, which must be zero: no test is needed.
Sines and places of the poses are computed in float64 on the host, so that every backend counts the same.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, passes_for, ti
from moteslam.kernels.types import F32, F32_2D, I32, I32_1D, U8_1D, U32, U64_1D, func, kernel, template

AT_ONCE = 64  # Beams whose cells are found before the first is read: few enough to unroll and for the fastest cache
SPAN = 5  # Shifts along each axis that fit in a window
FULL_BYTE = 255  # Points counted before a byte of a word could overflow
ROW_BITS = 0x0101010101  # The lowest bit of each of five rows of a window
EVEN_BYTES = 0x00FF00FF00FF00FF


@func
def cell_along(a: F32, b: F32, shift: F32, first: F32, last: F32):
    """The column (or row) of the point a + b + shift [cells], clamped to first..last (whole numbers)."""
    return ti.cast(ti.floor(ti.min(ti.max(a + b + shift, first), last)), ti.i32)


@func
def cell_or_border(along: F32, last: U32):
    """A point's column (or row), or the last one if it is outside: unsigned, a negative number is large."""
    return ti.cast(ti.min(ti.cast(ti.cast(ti.floor(along), ti.i32), ti.u32), last), ti.i32)


@func
def sum_under_scan(cells: template, width: I32, height: I32, c: F32, s: F32, x: F32, y: F32, scan: template):
    """The sum of the cells under a scan, turned by (c, s), moved to (x, y).

    Points more than 2^31 cells below the grid count as outside too: the cast then gives the lowest number.
    """
    last_col, last_row = ti.cast(width - 1, ti.u32), ti.cast(height - 1, ti.u32)
    beams = scan.shape[1]
    total = 0
    under = ti.Vector([0] * AT_ONCE, dt=ti.i32)
    for block in range(beams // AT_ONCE):
        for j in range(AT_ONCE):
            b = block * AT_ONCE + j
            col = cell_or_border(c * scan[0, b] - s * scan[1, b] + x, last_col)
            row = cell_or_border(s * scan[0, b] + c * scan[1, b] + y, last_row)
            under[j] = row * width + col
        for j in range(AT_ONCE):
            # the mask changes nothing, but keeps the compiler from making slow gathers of this loop
            total = (total + ti.cast(cells[under[j]], ti.i32)) & 0x7FFFFFFF
    for b in range(beams // AT_ONCE * AT_ONCE, beams):
        col = cell_or_border(c * scan[0, b] - s * scan[1, b] + x, last_col)
        row = cell_or_border(s * scan[0, b] + c * scan[1, b] + y, last_row)
        total += ti.cast(cells[row * width + col], ti.i32)
    return total


class Match(NamedTuple):
    """The best pose around each particle."""

    scores: NDArray[np.int32]  # int32 [N]
    indices: NDArray[np.int32]  # int32 [N, 3] of its offsets in x, y and theta
    poses: NDArray[np.float64]  # float64 [N, 3] the particles moved by these; theta is not wrapped


@kernel
def _search(
    grid: U8_1D, width: I32, height: I32, frames: F32_2D, scan: F32_2D, shifts: F32_2D, order: I32_1D, scores: I32_1D,
    best: I32_1D, passes: I32,
):  # fmt: skip
    """Every pose of the lattice by itself, in the given order; of equal scores the first is kept.

    Place p moves the points by ``shifts[p]`` [cells] before their cells are found.
    """
    poses = scores.shape[0]
    headings = frames.shape[0] // poses
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread()))
    for k in range(poses * passes):
        if k % passes:
            continue
        i = k // passes
        top, chosen = -1, 0
        for v in range(order.shape[0]):
            place, f = order[v] // headings, i * headings + order[v] % headings
            x, y = frames[f, 2] + shifts[place, 0], frames[f, 3] + shifts[place, 1]
            total = sum_under_scan(grid, width, height, frames[f, 0], frames[f, 1], x, y, scan)
            if total > top:
                top, chosen = total, order[v]
        scores[i], best[i] = top, chosen


@func
def _nibble(word: I32):
    """Four bits of four bytes that are 0 or 1."""
    return ti.cast((word | (word >> 7) | (word >> 14) | (word >> 21)) & 15, ti.u64)


@kernel
def _build_windows(words: I32_1D, width: I32, height: I32, row: I32, col: I32, columns: I32, windows: U64_1D):
    """The windows of the box of cells that begins at (col, row), multiples of 4."""
    stride = width // 4
    ti.loop_config(serialize=ti.static(one_thread()))
    for r in range(windows.shape[0] // columns):
        for k in range(columns):
            left = (col >> 2) + k
            right = left + 1
            at_left, at_right = ti.min(ti.max(left, 0), stride - 1), ti.min(ti.max(right, 0), stride - 1)
            bits = ti.u64(0)
            for j in ti.static(range(8)):
                start = ti.min(ti.max(row + 4 * r + j, 0), height - 1) * stride  # outside: the zero border
                a = ti.select(left == at_left, words[start + at_left], 0)
                b = ti.select(right == at_right, words[start + at_right], 0)
                bits |= (_nibble(a) | (_nibble(b) << ti.u64(4))) << ti.u64(8 * j)
            windows[r * columns + k] = bits


@kernel
def _search_windows(
    windows: U64_1D, row: I32, col: I32, columns: I32, last_row: I32, last_col: I32, low: I32, frames: F32_2D,
    scan: F32_2D, corners: I32_1D, rank: I32_1D, scores: I32_1D, best: I32_1D, passes: I32,
):  # fmt: skip
    """All shifts of a heading at once; ``low`` is the smallest shift, ``corners`` where a place is in the window."""
    poses, places, beams = scores.shape[0], corners.shape[0], scan.shape[1]
    headings = frames.shape[0] // poses
    low_row, high_row = ti.cast(row - low, ti.f32), ti.cast(last_row - low, ti.f32)
    low_col, high_col = ti.cast(col - low, ti.f32), ti.cast(last_col - low, ti.f32)
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread()))
    for k in range(poses * passes):
        if k % passes:
            continue
        i = k // passes
        top = ti.i64(-1)
        for h in range(headings):
            f = i * headings + h
            c, s, x, y = frames[f, 0], frames[f, 1], frames[f, 2], frames[f, 3]
            even, odd = ti.Vector([0] * SPAN, dt=ti.u64), ti.Vector([0] * SPAN, dt=ti.u64)
            for block in range((beams + FULL_BYTE - 1) // FULL_BYTE):
                count = ti.Vector([0] * SPAN, dt=ti.u64)
                for b in range(block * FULL_BYTE, ti.min((block + 1) * FULL_BYTE, beams)):
                    across = cell_along(c * scan[0, b], -(s * scan[1, b]), x, low_col, high_col) + low - col
                    up = cell_along(s * scan[0, b], c * scan[1, b], y, low_row, high_row) + low - row
                    window = windows[(up >> 2) * columns + (across >> 2)]
                    window = window >> ti.cast(((up & 3) << 3) + (across & 3), ti.u64)
                    for j in ti.static(range(SPAN)):
                        count[j] += (window >> ti.u64(j)) & ti.u64(ROW_BITS)
                even += count & ti.u64(EVEN_BYTES)
                odd += (count >> ti.u64(8)) & ti.u64(EVEN_BYTES)
            total = ti.Vector([0] * (SPAN * SPAN), dt=ti.i64)
            for j in ti.static(range(SPAN)):
                for r in ti.static(range(SPAN)):
                    half = odd[j] if ti.static(r % 2) else even[j]
                    total[r * SPAN + j] = ti.cast((half >> ti.u64(16 * (r // 2))) & ti.u64(0xFFFF), ti.i64)
            for p in range(places):
                v = p * headings + h
                top = ti.max(top, total[corners[p]] * rank.shape[0] + (rank.shape[0] - 1 - rank[v]))
        scores[i] = ti.cast(top // rank.shape[0], ti.i32)
        best[i] = rank.shape[0] - 1 - ti.cast(top % rank.shape[0], ti.i32)


def match_poses(
    occupied: NDArray[np.uint8],
    origin: ArrayLike,
    cell_size: float,
    poses: ArrayLike,
    points: ArrayLike,
    *,
    offsets_xy: ArrayLike,
    offsets_theta: ArrayLike,
) -> Match:
    """The best of the poses around each, by the sum of the cells under the scan (section III.D.2 of the paper).

    The poses tried are ``(x + offsets_xy[i], y + offsets_xy[j], theta + offsets_theta[k])``, the shift in the frame
    of the map. Of equal scores the one nearest the centre is kept, by (i - ci)^2 + (j - cj)^2 + (k - ck)^2 where c is
    the offset closest to 0, then the smallest i, j, k. If every shift is a whole number of cells, and they span at most
    ``SPAN``, cells are shifted instead of points: the cell under each point is found for the unshifted pose, and the
    shift is added to it.

    Args:
        occupied: uint8 [H, W] of 0 and 1, W a multiple of 8, its outermost ring of cells zero: points beyond the grid
            count zero.
        origin: [2] (x, y) of the corner of cell [0, 0] [m].
        cell_size: [m].
        poses: [N, 3].
        points: [k, 2] in the frame of each pose [m].
        offsets_xy: [a] [m], for x and for y.
        offsets_theta: [b] [rad].
    """
    check_array("occupied", occupied, np.uint8, (None, None))
    height, width = occupied.shape
    if width % 8 or not width or height < 2:
        raise InputError(f"{height} x {width} cells, expected two rows, columns a multiple of 8", field="occupied")
    if occupied[0].any() or occupied[-1].any() or occupied[:, 0].any() or occupied[:, -1].any():
        raise InputError("a cell of the outermost ring is not 0, expected a border of zeros", field="occupied")
    poses = as_finite("poses", poses, np.float64, (None, 3))
    xy = as_finite("offsets_xy", offsets_xy, np.float64, (None,))
    theta = as_finite("offsets_theta", offsets_theta, np.float64, (None,))
    turned = np.repeat(poses, len(theta), axis=0)
    turned[:, 2] += np.tile(theta, len(poses))
    corner = as_finite("origin", origin, np.float64, (2,))
    places = (np.cos(turned[:, 2]), np.sin(turned[:, 2]), *((turned[:, :2] - corner) / cell_size).T)
    frames = np.stack(places, axis=1).astype(np.float32)  # in cells, as the scan
    scan = np.ascontiguousarray((as_finite("points", points, np.float64, (None, 2)) / cell_size).T, np.float32)
    scores, best = np.zeros(len(poses), np.int32), np.zeros(len(poses), np.int32)
    i, j, k = np.indices((len(xy), len(xy), len(theta)))
    centre, ahead = np.abs(xy).argmin(), np.abs(theta).argmin()
    distance = (i - centre) ** 2 + (j - centre) ** 2 + (k - ahead) ** 2
    order = np.argsort(distance.reshape(-1), kind="stable").astype(np.int32)  # nearest the centre first
    whole = np.rint(xy / cell_size)
    is_lattice = (np.abs(xy / cell_size - whole) < 1e-6).all() and np.ptp(whole) < SPAN and scan.shape[1] < 2**16
    if len(poses) and is_lattice:
        cells = whole.astype(np.int32)
        low = int(cells.min())
        (col, last_col), (row, last_row) = _box(frames, scan, low, width, height)
        columns, rows = (last_col - col) // 4 + 1, (last_row - row) // 4 + 1
        windows = np.empty(columns * rows, np.uint64)
        words = occupied.reshape(-1).view(np.dtype("<i4"))  # the first of four cells in the lowest byte
        _build_windows(words, width, height, row, col, columns, windows)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order), dtype=np.int32)
        corners = ((cells - low)[None, :] * SPAN + (cells - low)[:, None]).reshape(-1).astype(np.int32)
        _search_windows(
            windows, row, col, columns, last_row, last_col, low, frames, scan, corners, rank, scores, best,
            passes_for(len(scores)),
        )  # fmt: skip
        best = order[best]
    elif len(poses):
        shifts = np.stack(np.meshgrid(xy / cell_size, xy / cell_size, indexing="ij"), axis=-1).reshape(-1, 2)
        _search(
            occupied.reshape(-1), width, height, frames, scan, shifts.astype(np.float32), order, scores, best,
            passes_for(len(poses)),
        )  # fmt: skip
    indices = np.stack(np.unravel_index(best, (len(xy), len(xy), len(theta))), axis=-1).astype(np.int32)
    moved = poses + np.stack((xy[indices[:, 0]], xy[indices[:, 1]], theta[indices[:, 2]]), axis=-1)
    return Match(scores, indices, moved)


def _box(
    frames: NDArray[np.float32], scan: NDArray[np.float32], low: int, width: int, height: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """First (a multiple of 4) and last window corner along columns and rows that any point of any pose can need."""
    radius = float(np.sqrt((scan.astype(np.float64) ** 2).sum(axis=0).max(initial=0.0)))
    c, s = (float(a) for a in frames[0, :2])
    x, y = c * scan[0] - s * scan[1], s * scan[0] + c * scan[1]
    spread = radius * float(np.hypot(frames[:, 0] - c, frames[:, 1] - s).max()) + 2 + 1e-6 * radius
    sides = []
    for points, place, cells in ((x, frames[:, 2], width), (y, frames[:, 3], height)):
        first = max(float(points.min(initial=0.0)) - spread, -radius - 2) + float(place.min()) + low
        last = min(float(points.max(initial=0.0)) + spread, radius + 2) + float(place.max()) + low
        # corners below -8 hold nothing, nor do those from the border of zeros on
        begin = int(np.clip(np.floor(first) // 4 * 4, -8, (cells - 1) // 4 * 4))
        sides.append((begin, int(np.clip(np.ceil(last), begin, cells - 1))))
    return sides[0], sides[1]
