"""Ray casting in NumPy, float64: every ray against every segment, and cell by cell through a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def cast_rays(
    segments: ArrayLike, origins: ArrayLike, angles: ArrayLike, *, max_range: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Range [n] of every ray, inf where it meets nothing, and |sin| [n] of the angle at which it meets the wall."""
    walls, origins = np.asarray(segments, np.float64), np.asarray(origins, np.float64)
    angles = np.asarray(angles, np.float64)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    start, end = walls[:, :2] - origins[:, None], walls[:, 2:] - origins[:, None]
    side0, side1 = c * start[..., 1] - s * start[..., 0], c * end[..., 1] - s * end[..., 0]
    along0, along1 = c * start[..., 0] + s * start[..., 1], c * end[..., 0] + s * end[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = along0 + side0 / (side0 - side1) * (along1 - along0)
    met = (side0 * side1 <= 0) & (side0 != side1) & (distance >= 0)
    distance = np.where(met, distance, np.inf)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(angles))
    length = np.hypot(*(walls[:, 2:] - walls[:, :2]).T)
    sine = np.abs(side0 - side1)[rows, nearest] / length[nearest]
    ranges = distance[rows, nearest]
    return np.where(ranges <= max_range, ranges, np.inf), sine


def range_in_grid(
    occupied: NDArray[np.bool_], origin: ArrayLike, cell_size: float, pose: ArrayLike, beam: float, *, max_range: float
) -> float:
    """How far a beam gets before it enters an occupied cell: every cell side it crosses, in order."""
    x, y, theta = np.asarray(pose, np.float64)
    at = (np.array((x, y)) - np.asarray(origin, np.float64)) / cell_size
    step = np.array((np.cos(theta + beam), np.sin(theta + beam)))
    reach = max_range / cell_size
    crossings = [0.0]
    for axis in (0, 1):
        if step[axis] != 0:
            to = at[axis] + reach * step[axis]
            sides = np.arange(np.floor(min(at[axis], to)), np.ceil(max(at[axis], to)) + 1)
            crossings += list((sides - at[axis]) / step[axis])
    along = np.unique([t for t in crossings if 0 <= t <= reach])
    middles = np.append((along[1:] + along[:-1]) / 2, along[-1] + 1e-9)
    cells = np.floor(at + middles[:, None] * step).astype(int)
    height, width = occupied.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < width) & (cells[:, 1] < height)
    met = np.zeros(len(cells), bool)
    met[inside] = occupied[cells[inside, 1], cells[inside, 0]]
    return float(along[met.argmax()] * cell_size) if met.any() else np.inf
