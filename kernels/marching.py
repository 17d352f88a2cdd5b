"""Ranges expected in a grid: beams march through it by the distance field, and cell by cell near what is occupied.

For what an estimated map predicts; a world of walls is cast exactly (raycast.py), which is faster too. Where nothing
is near, a beam leaps as far as the distance field allows; near occupied cells it goes from one cell side to the next,
so that the result is the place where it enters the cell, not where some step size put it.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import LARGEST, as_finite, check_array
from moteslam.kernels.raycast import directions_of
from moteslam.kernels.runtime import runtime, ti
from moteslam.kernels.types import F32, F32_2D, F64_2D, kernel


@kernel
def _march_rays(
    distance: F32_2D, origins: F64_2D, headings: F32_2D, beams: F32_2D, cell_size: F32, max_range: F32, out: F32_2D
):
    height, width = distance.shape[0], distance.shape[1]
    leap = ti.f32(1.5) * cell_size  # two half diagonals of a cell, with room for rounding
    for i, b in ti.ndrange(out.shape[0], out.shape[1]):
        c = headings[0, i] * beams[0, b] - headings[1, i] * beams[1, b]
        s = headings[1, i] * beams[0, b] + headings[0, i] * beams[1, b]
        # in cells, and relative to the cell the pose is in: float32 keeps fractions of a cell however large the map
        base_col, base_row = ti.floor(origins[i, 0]), ti.floor(origins[i, 1])
        x, y = ti.cast(origins[i, 0] - base_col, ti.f32), ti.cast(origins[i, 1] - base_row, ti.f32)
        first_col, first_row = ti.cast(base_col, ti.i32), ti.cast(base_row, ti.i32)
        col, row = 0, 0
        step_col, step_row = (1 if c > 0 else -1), (1 if s > 0 else -1)
        ahead_x, ahead_y = (1 if c > 0 else 0), (1 if s > 0 else 0)
        far = ti.f32(1e12)  # a beam along an axis crosses no side of the other
        per_x = ti.f32(1.0) / c if abs(c) > ti.f32(1e-12) else far
        per_y = ti.f32(1.0) / s if abs(s) > ti.f32(1e-12) else far
        along, reach, found = ti.f32(0.0), max_range / cell_size, ti.f32(math.inf)
        walking = True
        while walking:
            here_col, here_row = first_col + col, first_row + row
            free = ti.f32(0.0)  # beyond the grid nothing is known of what is near
            if 0 <= here_col and here_col < width and 0 <= here_row and here_row < height:
                free = distance[here_row, here_col] - leap
                if distance[here_row, here_col] <= ti.f32(0.0):
                    found = along
            if free > cell_size:
                along = along + free / cell_size
                col, row = ti.cast(ti.floor(x + along * c), ti.i32), ti.cast(ti.floor(y + along * s), ti.i32)
            else:
                next_x = (ti.cast(col + ahead_x, ti.f32) - x) * per_x if abs(c) > ti.f32(1e-12) else far
                next_y = (ti.cast(row + ahead_y, ti.f32) - y) * per_y if abs(s) > ti.f32(1e-12) else far
                if next_x < next_y:
                    col += step_col
                else:
                    row += step_row
                along = ti.max(along, ti.min(next_x, next_y))
            gone = (
                (here_col < 0 and step_col < 0) or (here_col >= width and step_col > 0)
                or (here_row < 0 and step_row < 0) or (here_row >= height and step_row > 0)
            )  # fmt: skip
            walking = found > reach and along <= reach and not gone
        out[i, b] = found * cell_size if found <= reach else ti.f32(math.inf)


def distance_field(occupied: NDArray[np.bool_], cell_size: float) -> NDArray[np.float32]:
    """How far the middle of each cell is from the middle of the nearest occupied cell (exact, Euclidean).

    Args:
        occupied: bool [H, W].
        cell_size: [m].

    Returns:
        float32 [H, W] [m]; 0 in occupied cells; the grid's diagonal everywhere if none is.

    Raises:
        InputError: another type or shape, no cells, or a cell size that is not positive.
    """
    check_array("occupied", occupied, np.bool_, (None, None))
    _check_length("cell_size", cell_size)
    if not occupied.size:
        raise InputError("no cells, expected one at least", field="occupied")
    if not occupied.any():
        return np.full(occupied.shape, math.hypot(*occupied.shape) * cell_size, np.float32)
    import cv2

    cells = cv2.distanceTransform((~occupied).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(cells * np.float32(cell_size), np.float32)


def march_rays(
    distance: NDArray[np.float32],
    origin: ArrayLike,
    cell_size: float,
    poses: ArrayLike,
    beam_angles: ArrayLike,
    *,
    max_range: float,
) -> NDArray[np.float32]:
    """How far each beam gets before it enters an occupied cell.

    Args:
        distance: float32 [H, W] of ``distance_field`` [m].
        origin: [2] (x, y) of the corner of cell [0, 0] [m].
        cell_size: [m].
        poses: [n, 3] of the sensor, on the grid or not.
        beam_angles: [b] of the beams, in its frame [rad].
        max_range: beyond which nothing is seen [m].

    Returns:
        float32 [n, b] [m]; 0 from within an occupied cell, ``inf`` where none is entered within max_range. Off by at
        most 2^-20 of the range, but for a beam that passes a cell's corner within that: it may or may not meet it.

    Raises:
        InputError: shapes that do not fit, values that are not finite or positive where they must be.
    """
    check_array("distance", distance, np.float32, (None, None))
    poses = as_finite("poses", poses, np.float64, (None, 3))
    beams = as_finite("beam_angles", beam_angles, np.float64, (None,))
    corner = as_finite("origin", origin, np.float64, (2,))
    _check_length("cell_size", cell_size)
    _check_length("max_range", max_range)
    if len(poses) * len(beams) > LARGEST:
        raise InputError(f"{len(poses)} x {len(beams)} rays, expected at most {LARGEST}", field="poses")
    cells = (poses[:, :2] - corner) / cell_size
    if max_range / cell_size > 1e6 or (np.abs(cells) > 1e9).any():
        raise InputError("more than 1e9 cells away, or a range of more than 1e6 cells, expected less", field="poses")
    out = np.empty((len(poses), len(beams)), np.float32)
    runtime()
    if out.size:
        _march_rays(distance, cells, directions_of(poses[:, 2]), directions_of(beams), cell_size, max_range, out)
    return out


def _check_length(name: str, length: float) -> None:
    if not 0 < length < math.inf:
        raise InputError(f"{length}, expected a positive length [m]", field=name)
