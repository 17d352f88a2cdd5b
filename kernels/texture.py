"""The colours of the floor, gathered from RGB-D frames into cells: section III.E of the paper.

Sums are integers, so that the order in which threads add to a cell does not matter: the same bytes on one thread and on
many.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, ti
from moteslam.kernels.types import F32, F32_1D, F32_2D, I32, I32_1D, I32_2D, I64_1D, U8_1D, U16_1D, kernel


@kernel
def _add_frame(
    sums: I64_1D, rows: I32, columns: I32, disparity: U16_1D, rgb: U8_1D, height: I32, width: I32, calibration: F32_1D,
    mount: F32_2D, x0: F32, y0: F32, heading_cos: F32, heading_sin: F32, per_metre: F32, ceiling: F32, farthest: F32,
    nothing: I32, flat: I32,
):  # fmt: skip
    focal, cx, cy = calibration[0], calibration[1], calibration[2]
    slope, offset, scale = calibration[3], calibration[4], calibration[5]
    align, align_dd, align_column, align_row = calibration[6], calibration[7], calibration[8], calibration[9]
    ti.loop_config(serialize=ti.static(one_thread()))
    for row, column in ti.ndrange(height, width):
        raw = ti.cast(disparity[row * width + column], ti.i32)
        dd = slope * ti.cast(raw, ti.f32) + offset
        if raw > 0 and raw < nothing and dd * farthest >= scale:
            depth = scale / dd
            i, j = ti.cast(column, ti.f32), ti.cast(row, ti.f32)
            # the pixel of the colour image that saw the same point
            rgb_column = ti.cast(ti.floor(align * i - align_dd * dd + align_column + ti.f32(0.5)), ti.i32)
            rgb_row = ti.cast(ti.floor(align * j + align_row + ti.f32(0.5)), ti.i32)
            ox, oy = (i - cx) / focal * depth, (j - cy) / focal * depth  # III.5 and III.6
            z = mount[2, 0] * ox + mount[2, 1] * oy + mount[2, 2] * depth + mount[2, 3]  # III.7 and III.8
            if z < ceiling and rgb_column >= 0 and rgb_column < width and rgb_row >= 0 and rgb_row < height:
                bx = mount[0, 0] * ox + mount[0, 1] * oy + mount[0, 2] * depth + mount[0, 3]
                by = mount[1, 0] * ox + mount[1, 1] * oy + mount[1, 2] * depth + mount[1, 3]
                if flat == 1:  # along the ray to where it meets the floor
                    scaled = mount[2, 3] / (mount[2, 3] - z)
                    bx = mount[0, 3] + scaled * (bx - mount[0, 3])
                    by = mount[1, 3] + scaled * (by - mount[1, 3])
                col = ti.cast(ti.floor((x0 + heading_cos * bx - heading_sin * by) * per_metre), ti.i32)
                up = ti.cast(ti.floor((y0 + heading_sin * bx + heading_cos * by) * per_metre), ti.i32)
                if col >= 0 and col < columns and up >= 0 and up < rows:
                    cell, pixel = 4 * (up * columns + col), 3 * (rgb_row * width + rgb_column)
                    for k in ti.static(range(3)):
                        ti.atomic_add(sums[cell + k], ti.cast(rgb[pixel + k], ti.i64))
                    ti.atomic_add(sums[cell + 3], ti.i64(1))


def add_frame(
    sums: NDArray[np.int64],
    disparity: NDArray[np.uint16],
    rgb: NDArray[np.uint8],
    pose: ArrayLike,
    *,
    corner: tuple[float, float],
    cell_size: float,
    calibration: ArrayLike,
    mount: ArrayLike,
    height_limit: float,
    max_depth: float,
    nothing: int,
    flat: bool = False,
) -> None:
    """Add the points of one frame that lie near the floor to the cells they fall into, in place.

    Each disparity d gives a depth (scale / dd, dd = slope d + offset), the pixel of the colour image that saw the same
    point, and the point itself (III.5, III.6), rotated to the robot's axes and moved to the camera's place (III.7 and
    III.8, corrected as in ``docs/theory/paper.md``); points below ``height_limit`` count.

    Args:
        sums: int64 [H, W, 4] sums of red, green and blue, and the number of points; row 0 the smallest y.
        disparity: uint16 [h, w], raw; 0, ``nothing`` and above are no measurement.
        rgb: uint8 [h, w, 3], red, green, blue.
        pose: [3] of the robot when the disparity image was taken.
        corner: (x, y) of the corner of cell [0, 0] [m].
        cell_size: [m].
        calibration: [10] focal length, column and row of the principal point [pixels]; slope, offset and scale [m] of
            the depth; scale, factor of dd, offset of the column and offset of the row of the pixel in the colour image.
        mount: [3, 4] from optical axes to the robot's: rotation, and place [m] in the last column.
        height_limit: points at or above it are left out [m]; 0.1 in the paper.
        max_depth: points deeper than this are left out [m].
        flat: move these points along their rays to the floor, whatever their depth.
    """
    check_array("sums", sums, np.int64, (None, None, 4), written=True)
    check_array("disparity", disparity, np.uint16, (None, None))
    check_array("rgb", rgb, np.uint8, (*disparity.shape, 3))
    x, y, theta = (float(v) for v in as_finite("pose", pose, np.float64, (3,)))
    numbers = as_finite("calibration", calibration, np.float32, (10,))
    matrix = as_finite("mount", mount, np.float32, (3, 4))
    if flat and not matrix[2, 3] > height_limit:
        raise InputError(f"a camera {matrix[2, 3]:g} m above a flat floor, expected more than its limit", field="mount")
    if sums.size and disparity.size:
        _add_frame(
            sums.reshape(-1), *sums.shape[:2], disparity.reshape(-1), rgb.reshape(-1), *disparity.shape, numbers,
            matrix, x - corner[0], y - corner[1], float(np.cos(theta)), float(np.sin(theta)), 1 / cell_size,
            height_limit, max_depth, nothing, flat,
        )  # fmt: skip


UNKNOWN = -1  # In a packed map: a cell without a colour


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
        packed: int32 [H, W] the map's colours likewise, ``UNKNOWN`` without one; row 0 the smallest y.
        corner: (x, y) of the corner of its cell [0, 0] [m].
        cell_size: of the map [m].
        limit: largest difference that counts for a point, over its three channels: an outlier counts no more than that.

    Returns int32 [n, 2]: the sum of the differences over the points that fall on coloured cells, and how many those
    are.
    """
    patch = as_finite("points", points, np.float32, (None, 2))
    check_array("colours", colours, np.int32, (len(patch),))
    check_array("packed", packed, np.int32, (None, None))
    places = as_finite("poses", poses, np.float64, (None, 3))
    columns = (places[:, 0] - corner[0], places[:, 1] - corner[1], np.cos(places[:, 2]), np.sin(places[:, 2]))
    moved = np.stack(columns, axis=-1).astype(np.float32)
    out = np.zeros((len(places), 2), np.int32)
    if len(places) and len(patch) and packed.size:
        _match_colours(
            np.ascontiguousarray(patch.T), colours, moved, packed.reshape(-1), *packed.shape, 1 / cell_size, limit, out
        )
    return out
