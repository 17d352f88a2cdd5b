"""The Kinect in NumPy, float64: from the formulas as they are published, pixel by pixel, sharing nothing with ours."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twins.rays import cast_rays

FX = FY = 585.05108211
CX, CY = 315.83800193, 242.94140713
PLACE = np.array((0.18, 0.005, 0.36))
PITCH, YAW = 0.36, 0.021


def optical_to_robot(points: ArrayLike) -> NDArray[np.float64]:
    """Points [..., 3] in optical axes (x right, y down, z forward) in the robot's: turned by pitch, yaw, and moved."""
    right, down, forward = np.moveaxis(np.asarray(points, np.float64), -1, 0)
    x, y, z = forward, -right, -down
    x, z = np.cos(PITCH) * x + np.sin(PITCH) * z, -np.sin(PITCH) * x + np.cos(PITCH) * z
    x, y = np.cos(YAW) * x - np.sin(YAW) * y, np.sin(YAW) * x + np.cos(YAW) * y
    return np.stack((x, y, z), axis=-1) + PLACE


def disparity_of(depth: ArrayLike) -> NDArray[np.float64]:
    """The raw disparity, not rounded, of depths [m] of any shape."""
    return np.asarray((1.03 / np.asarray(depth, np.float64) - 3.31) / -0.00304)


def back_project(disparity: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_]]:
    """Points [h, w, 3] in the robot's frame, the pixel (row, column) [h, w, 2] of each in the colour image, and which
    pixels have both."""
    d = np.asarray(disparity, np.float64)
    j, i = np.mgrid[: d.shape[0], : d.shape[1]].astype(np.float64)
    dd = -0.00304 * d + 3.31
    valid = (d > 0) & (d < 2047) & (dd > 0)
    depth = 1.03 / np.where(valid, dd, 1)
    rgb_i = (526.37 * i - 4.5 * 1750.46 * dd + 19276) / 585.051
    rgb_j = (526.37 * j + 16662) / 585.051
    pixel = np.stack((np.floor(rgb_j + 0.5), np.floor(rgb_i + 0.5)), axis=-1).astype(np.int64)
    valid &= ((pixel >= 0) & (pixel < d.shape)).all(axis=-1)
    optical = np.stack(((i - CX) / FX * depth, (j - CY) / FY * depth, depth), axis=-1)
    return optical_to_robot(optical), pixel, valid


def add_frame(
    sums: NDArray[np.int64],
    disparity: ArrayLike,
    rgb: NDArray[np.uint8],
    pose: ArrayLike,
    *,
    corner: ArrayLike,
    cell_size: float,
    height_limit: float,
    max_depth: float,
    camera: ArrayLike | None = None,
) -> None:
    """What ``kernels.texture.add_frame`` does to sums [H, W, 4]; the floor is flat where ``camera`` [3] is given."""
    points, pixel, valid = back_project(disparity)
    valid &= max_depth * (-0.00304 * np.asarray(disparity, np.float64) + 3.31) >= 1.03
    valid &= points[..., 2] < height_limit
    x, y, theta = np.asarray(pose, np.float64)
    bx, by = points[valid, 0], points[valid, 1]
    if camera is not None:
        cx, cy, cz = np.asarray(camera, np.float64)
        share = cz / (cz - points[valid, 2])
        bx, by = cx + share * (bx - cx), cy + share * (by - cy)
    world = np.stack((x + np.cos(theta) * bx - np.sin(theta) * by, y + np.sin(theta) * bx + np.cos(theta) * by), -1)
    cells = np.floor((world - np.asarray(corner)) / cell_size).astype(np.int64)
    colours = rgb[pixel[valid, 0], pixel[valid, 1]].astype(np.int64)
    inside = ((cells >= 0) & (cells < sums.shape[1::-1])).all(axis=-1)
    columns, rows = cells[inside].T
    np.add.at(sums, (rows, columns), np.concatenate((colours[inside], np.ones((inside.sum(), 1), np.int64)), axis=-1))


def look(
    pixel: tuple[float, float], pose: ArrayLike, segments: ArrayLike, *, colour: bool
) -> tuple[NDArray[np.float64], float, bool]:
    """What a pixel (row, column) sees from a pose of the robot.

    Returns:
        the point [3] in the world [m], its depth along the optical axis [m], and whether it is on the floor; a point at
        infinity where neither floor nor wall is met.
    """
    row, column = pixel
    if colour:  # invert the published alignment: at infinity dd is 0, and the colour pixel moves in proportion to dd
        right = (585.051 * column - 19276) / 526.37
        down = (585.051 * row - 16662) / 526.37
        eye = np.array((4.5 * 1750.46 * 1.03 / 526.37 / FX, 0.0, 0.0))
    else:
        right, down, eye = column, row, np.zeros(3)
    ray = np.array(((right - CX) / FX, (down - CY) / FY, 1.0))
    start = optical_to_robot(eye)
    direction = optical_to_robot(eye + ray) - start
    x, y, theta = np.asarray(pose, np.float64)
    turn = np.array(((np.cos(theta), -np.sin(theta), 0), (np.sin(theta), np.cos(theta), 0), (0, 0, 1)))
    start, direction = turn @ start + (x, y, 0), turn @ direction
    level = float(np.hypot(*direction[:2]))
    ranges, _ = cast_rays(segments, start[None, :2], [np.arctan2(direction[1], direction[0])], max_range=1e6)
    to_wall = ranges[0] / level
    to_floor = -start[2] / direction[2] if direction[2] < 0 else np.inf
    depth = min(to_wall, to_floor)
    return start + depth * direction if np.isfinite(depth) else start * np.inf, float(depth), to_floor <= to_wall
