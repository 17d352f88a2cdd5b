"""Ray casting in NumPy, float64: every ray against every segment, and cell by cell through a grid."""

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
