"""How well the colours of a patch of floor fit a coloured map, for many poses at once: integers throughout."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.types import F32, F32_2D, I32, I32_1D, I32_2D, kernel

__all__ = ["UNKNOWN", "match_colours"]

UNKNOWN = -1
"""In a packed map: a cell without a colour."""


@kernel
def _match_colours(
    points: F32_2D, colours: I32_1D, poses: F32_2D, packed: I32_1D, rows: I32, columns: I32, per_metre: F32,
    limit: I32, out: I32_2D,
):  # fmt: skip
    ti.loop_config(serialize=ti.static(one_thread()))
    for n in range(poses.shape[0]):
        x, y, c, s = poses[n, 0], poses[n, 1], poses[n, 2], poses[n, 3]
        difference, known = 0, 0
        for k in range(points.shape[1]):
            col = ti.floor((x + c * points[0, k] - s * points[1, k]) * per_metre)
            row = ti.floor((y + s * points[0, k] + c * points[1, k]) * per_metre)
            if col >= 0.0 and row >= 0.0 and col < ti.cast(columns, ti.f32) and row < ti.cast(rows, ti.f32):
                there = packed[ti.cast(row, ti.i32) * columns + ti.cast(col, ti.i32)]
                if there >= 0:
                    here = colours[k]
                    apart = abs((here & 255) - (there & 255))
                    apart += abs(((here >> 8) & 255) - ((there >> 8) & 255))
                    apart += abs(((here >> 16) & 255) - ((there >> 16) & 255))
                    difference += ti.min(apart, limit)
                    known += 1
        out[n, 0], out[n, 1] = difference, known


def match_colours(
    points: ArrayLike,
    colours: NDArray[np.int32],
    poses: ArrayLike,
    packed: NDArray[np.int32],
    *,
    corner: tuple[float, float],
    cell_size: float,
    limit: int = 150,
) -> NDArray[np.int32]:
    """Compare a patch of floor, laid at each of many poses, with a coloured map.

    Args:
        points: [k, 2] of the patch, in the robot's frame [m].
        colours: int32 [k] red + 256 green + 65536 blue.
        poses: [n, 3] of the robot.
        packed: int32 [H, W] the map's colours likewise, ``UNKNOWN`` where it has none; row 0 the smallest y.
        corner: (x, y) of the corner of its cell [0, 0] [m].
        cell_size: of the map [m].
        limit: largest difference that counts for a point, over its three channels: an outlier counts no more than that.

    Returns:
        int32 [n, 2]: the sum of the differences over the points that fall on coloured cells, and how many those are.

    Raises:
        InputError: arrays that do not fit together, numbers that are not finite or out of bounds.
    """
    patch = as_finite("points", points, np.float32, (None, 2))
    check_array("colours", colours, np.int32, (len(patch),))
    check_array("packed", packed, np.int32, (None, None))
    places = as_finite("poses", poses, np.float64, (None, 3))
    if not (0 < limit <= 765 and cell_size > 0 and len(patch) * 765 < 2**31):
        raise InputError(f"{limit}, {cell_size:g} m, expected 1 to 765, and above 0", field="limit")
    columns = (places[:, 0] - corner[0], places[:, 1] - corner[1], np.cos(places[:, 2]), np.sin(places[:, 2]))
    moved = np.stack(columns, axis=-1).astype(np.float32)
    out = np.zeros((len(places), 2), np.int32)
    runtime()
    if len(places) and len(patch) and packed.size:
        _match_colours(
            np.ascontiguousarray(patch.T), colours, moved, packed.reshape(-1), *packed.shape, 1 / cell_size, limit, out
        )
    return out
