"""The log-odds update of an occupancy grid: a hit where a beam ends, a miss along its ray.

It runs on one thread. The rays of a scan meet near the robot, so that threads would need atomics on the same cells: two
cores with atomics are at best as fast (measured: 2.1 times the time on one core), and saturating sums depend on their
order. Serial, the result is the same bits everywhere.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import check_array
from moteslam.kernels.runtime import ti
from moteslam.kernels.types import I16_1D, I32, I32_1D, I32_2D, U8_1D, func, kernel, template


@func
def _add(log_odds: template, occupied: template, cell: I32, change: I32, limit: I32, threshold: I32):
    """Add to one cell, saturating, and update its occupied flag."""
    old = ti.cast(log_odds[cell], ti.i32)
    new = ti.min(ti.max(old + change, -limit), limit)
    log_odds[cell] = ti.cast(new, ti.i16)
    if (old > threshold) != (new > threshold):
        occupied[cell] = ti.cast(new > threshold, ti.u8)


@kernel
def _update_grid(
    log_odds: I16_1D, occupied: U8_1D, seen: I32_1D, fresh: I32_1D, ends: I32_2D, height: I32, width: I32,
    col: I32, row: I32, hit: I32, miss: I32, limit: I32, threshold: I32, scan: I32, guard: I32, per_ray: template,
):  # fmt: skip
    beams = ends.shape[0]
    if ti.static(not per_ray):
        ti.loop_config(serialize=True)
        for b in range(beams):  # the hits first: a cell that is hit gets no miss from another ray
            cell = ends[b, 1] * width + ends[b, 0]
            fresh[b] = ti.cast(seen[cell] != scan, ti.i32)
            if seen[cell] != scan:
                seen[cell] = scan
                _add(log_odds, occupied, cell, hit, limit, threshold)
        ti.loop_config(serialize=True)
        for b in range(beams):  # then the cells too near an end to get a miss from the same scan
            if fresh[b] and guard > 0:
                for up in range(ti.max(0, ends[b, 1] - guard), ti.min(height, ends[b, 1] + guard + 1)):
                    for across in range(ti.max(0, ends[b, 0] - guard), ti.min(width, ends[b, 0] + guard + 1)):
                        seen[up * width + across] = scan
    ti.loop_config(serialize=True)
    for b in range(beams):
        traced = 1
        if ti.static(not per_ray):
            traced = fresh[b]  # a beam that ends where another ended has the same ray
        if traced:
            across, up = ends[b, 0] - col, ends[b, 1] - row
            step_across = ti.select(across < 0, -1, 1)
            step_up = ti.select(up < 0, -width, width)
            across, up = abs(across), abs(up)
            major, minor = ti.max(across, up), ti.min(across, up)
            step_major = ti.select(across >= up, step_across, step_up)
            step_minor = ti.select(across >= up, step_up, step_across)
            cell = row * width + col
            error = major // 2
            for _ in range(major):
                if ti.static(per_ray):
                    _add(log_odds, occupied, cell, -miss, limit, threshold)
                else:
                    if seen[cell] != scan:
                        seen[cell] = scan
                        _add(log_odds, occupied, cell, -miss, limit, threshold)
                error -= minor
                turned = ti.cast(error < 0, ti.i32)
                cell += step_major + turned * step_minor
                error += turned * major
            if ti.static(per_ray):
                _add(log_odds, occupied, cell, hit, limit, threshold)


def update_grid(
    log_odds: NDArray[np.int16],
    occupied: NDArray[np.uint8],
    seen: NDArray[np.int32],
    start: ArrayLike,
    ends: ArrayLike,
    *,
    hit: int,
    miss: int,
    limit: int,
    threshold: int,
    scan: int,
    guard: int = 0,
    per_ray: bool = False,
) -> None:
    """Enter one scan into a grid, in place: the end of each beam gets ``+hit``, its ray ``-miss``.

    The inverse sensor model along a beam (Probabilistic Robotics, table 9.1, in log-odds) on the cells of the
    Bresenham ray from the start up to, not including, the end cell. Sums saturate at plus and minus ``limit``. Each
    cell changes at most once a scan; one that is hit gets no miss. With ``per_ray`` every ray counts, beam by beam, its
    free cells before its end, so that a cell crossed by k rays changes k times: the paper, taken literally.

    Args:
        log_odds: int16 [H, W], fixed point in a unit of the caller's.
        occupied: uint8 [H, W], W a multiple of 8; 1 where log_odds > threshold, else 0; kept so.
        seen: int32 [H, W] the last scan that changed each cell, zero at first. Not used with ``per_ray``.
        start: [2] (col, row) of the cell the rays start in.
        ends: [k, 2] (col, row) of the cells they end in.
        hit: added at an end, 0 to 32767, as ``miss``, ``limit`` and ``threshold``, in the unit of log_odds.
        scan: positive, larger in each call with the same ``seen``, below 2^31.
        guard: cells this near to an end of the scan (in rows and columns) get no miss from it: beams that graze a wall
            pass within a cell of their neighbours' ends and would erase it. Not with ``per_ray``.
        per_ray: whether every ray counts.
    """
    shape = log_odds.shape
    check_array("log_odds", log_odds, np.int16, (None, None), written=True)
    check_array("occupied", occupied, np.uint8, shape, written=True)
    check_array("seen", seen, np.int32, shape, written=True)
    height, width = shape
    if width % 8:
        raise InputError(f"{width} columns, expected a multiple of 8", field="occupied")
    start, ends = _cells("start", start, (2,), shape), _cells("ends", ends, (None, 2), shape)
    if len(ends):
        fresh = np.empty(1 if per_ray else len(ends), np.int32)
        _update_grid(
            log_odds.reshape(-1), occupied.reshape(-1), seen.reshape(-1), fresh, ends, height, width, *start.tolist(),
            hit, miss, limit, threshold, scan, guard, per_ray,
        )  # fmt: skip


def _cells(name: str, cells: ArrayLike, shape: tuple[int | None, ...], grid: tuple[int, ...]) -> NDArray[np.int32]:
    """Cells (col, row) as int32, each inside the outermost ring of the grid."""
    array = np.asarray(cells)
    if array.size and array.dtype.kind not in "iu":
        raise InputError(f"{array.dtype}, expected integers (col, row)", field=name)
    last = np.array((grid[1] - 2, grid[0] - 2))
    if array.ndim == len(shape) and array.shape[-1] == 2 and ((array < 1) | (array > last)).any():
        raise InputError(f"a cell outside the grid, expected 1..{last[0]}, 1..{last[1]}", field=name)
    return check_array(name, np.ascontiguousarray(array, np.int32), np.int32, shape)
