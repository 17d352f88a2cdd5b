"""How a driver minds who is ahead: it slows down, and waits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.platform import Platform

STOP_GAP, SLOW_GAP = 0.25, 0.9
"""The robot stops with the first gap to who is ahead, and slows down over the second before that [m]."""
SIDE_GAP = 0.08
"""Who leaves less than this beside the robot is in its path [m]."""
PATIENCE = 60.0
"""How long a driver waits for its path to become free [s]."""


def pace(
    pose: tuple[float, float, float],
    platform: Platform,
    centres: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> float:
    """The share of its speed, 0 to 1, that the robot drives at: 0 with somebody right ahead.

    Args:
        pose: of the robot.
        platform: its body.
        centres: [n, 2] of people and doors, as discs [m].
        radii: [n] of the discs [m].
    """
    x, y, theta = pose
    away = centres - (x, y)
    cos, sin = math.cos(theta), math.sin(theta)
    ahead, left = away @ (cos, sin), away @ (-sin, cos)
    in_path = (ahead > 0) & (np.abs(left) < platform.width / 2 + radii + SIDE_GAP)
    if not in_path.any():
        return 1.0
    gap = float((ahead - radii)[in_path].min()) - platform.length / 2
    return min(max((gap - STOP_GAP) / SLOW_GAP, 0.0), 1.0)
