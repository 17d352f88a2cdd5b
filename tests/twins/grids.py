"""The grid kernels in plain Python and NumPy: update and matching."""

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray


def bresenham(start: tuple[int, int], end: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """The cells (col, row) from start up to, not including, end."""
    (x, y), (across, up) = start, (end[0] - start[0], end[1] - start[1])
    steep = abs(up) > abs(across)
    major, minor = max(abs(across), abs(up)), min(abs(across), abs(up))
    error = major // 2
    for _ in range(major):
        yield x, y
        error -= minor
        turn = error < 0
        error += major if turn else 0
        if steep or turn:
            y += 1 if up >= 0 else -1
        if not steep or turn:
            x += 1 if across >= 0 else -1


def update_grid(
    log_odds: NDArray[np.int16], start: ArrayLike, ends: ArrayLike, *, hit: int, miss: int, limit: int,
    guard: int = 0, per_ray: bool = False,
) -> NDArray[np.int16]:  # fmt: skip
    grid = log_odds.astype(np.int64)
    first = tuple(int(v) for v in np.asarray(start))
    cells = [(int(col), int(row)) for col, row in np.asarray(ends)]

    def add(cell: tuple[int, int], change: int) -> None:
        col, row = cell
        grid[row, col] = min(max(int(grid[row, col]) + change, -limit), limit)

    if per_ray:
        for end in cells:
            for cell in bresenham(first, end):
                add(cell, -miss)
            add(end, hit)
    else:
        hits = set(cells)
        near = range(-guard, guard + 1)
        kept = {(col + i, row + j) for col, row in hits for i in near for j in near}
        for cell in {cell for end in hits for cell in bresenham(first, end)} - kept:
            add(cell, -miss)
        for cell in hits:
            add(cell, hit)
    return grid.astype(np.int16)


def cells_under(
    origin: ArrayLike, cell_size: float, pose: ArrayLike, points: ArrayLike, shift: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.int64]:
    """The cells [k, 2] (col, row) of points [k, 2] seen from a pose; in float32, like the kernels."""
    x, y, theta = np.asarray(pose, np.float64)
    scan = (np.asarray(points, np.float64).reshape(-1, 2).T / cell_size).astype(np.float32)
    c, s = np.float32(np.cos(theta)), np.float32(np.sin(theta))
    place = ((np.array((x, y)) - np.asarray(origin, np.float64)) / cell_size).astype(np.float32)
    place = place + np.asarray(shift, np.float32)
    col, row = c * scan[0] - s * scan[1] + place[0], s * scan[0] + c * scan[1] + place[1]
    return np.floor(np.stack((col, row), axis=-1)).astype(np.int64)


def values(occupied: NDArray[np.uint8], cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """What each cell (col, row) holds; zero outside."""
    height, width = occupied.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < width) & (cells[:, 1] < height)
    found = np.zeros(len(cells), np.int64)
    found[inside] = occupied[cells[inside, 1], cells[inside, 0]]
    return found


def match_poses(
    occupied: NDArray[np.uint8], origin: ArrayLike, cell_size: float, poses: ArrayLike, points: ArrayLike, *,
    offsets_xy: ArrayLike, offsets_theta: ArrayLike,
) -> tuple[list[int], list[tuple[int, int, int]]]:  # fmt: skip
    """Score and offset (i, j, k) of the best around each pose."""
    xy, theta = np.asarray(offsets_xy, np.float64), np.asarray(offsets_theta, np.float64)
    centre, ahead = int(np.abs(xy).argmin()), int(np.abs(theta).argmin())
    whole = np.rint(xy / cell_size).astype(int)
    lattice = bool(np.allclose(xy / cell_size, whole, rtol=0, atol=1e-6))
    scores, found = [], []
    for pose in np.asarray(poses, np.float64):
        tried = []
        for i, j, k in product(range(len(xy)), range(len(xy)), range(len(theta))):
            turned = pose + np.array((0, 0, theta[k]))
            if lattice:
                cells = cells_under(origin, cell_size, turned, points) + whole[[i, j]]
            else:
                cells = cells_under(origin, cell_size, turned, points, (xy[i] / cell_size, xy[j] / cell_size))
            rank = (i - centre) ** 2 + (j - centre) ** 2 + (k - ahead) ** 2
            tried.append((-int(values(occupied, cells).sum()), rank, (i, j, k)))
        best = min(tried)
        scores.append(-best[0])
        found.append(best[2])
    return scores, found
