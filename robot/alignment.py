"""Laying points on points: the rigid motion, and the scale, of the least squared distance (Umeyama 1991)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import Poses


def umeyama(source: NDArray[np.float64], target: NDArray[np.float64]) -> Poses:
    """The rigid motion that lays points on points with the least squared distance (Umeyama 1991, without scale).

    In the plane its singular value decomposition has a closed form: the angle is that of the summed dot and cross
    products of the centred points. Where the points leave it open (all in one place) there is no rotation.

    Args:
        source, target: [n, 2] [m], row by row the same point.

    Returns:
        pose [3], such that transform_points(pose, source) is near target.
    """
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    a, b = source - centre, target - goal
    dot = float((a * b).sum())
    cross = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    # below this the sums are rounding of coordinates far from the origin, and their angle is noise
    rounding = len(a) * (np.finfo(float).eps * max(1.0, float(np.abs(source).max()))) ** 2
    angle = float(np.arctan2(cross, dot)) if np.hypot(dot, cross) > rounding else 0.0
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array(
        [
            goal[0] - cos * centre[0] + sin * centre[1],
            goal[1] - sin * centre[0] - cos * centre[1],
            angle,
        ]
    )


def umeyama_scale(source: NDArray[np.float64], target: NDArray[np.float64]) -> float:
    """The factor that lays ``source`` [n, 2] on ``target`` [n, 2] with the least squared distance; 1 for a point.

    In the plane it is the length of the summed dot and cross products of the centred points, over the sum of squares.
    """
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    size = float((a * a).sum())
    dot, cross = float((a * b).sum()), float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    return float(np.hypot(dot, cross)) / size if size > 0 else 1.0
