"""Odometry that has not moved yet: the robot stands, or the log has no odometry.

Logs without odometry have the same pose at every scan. Where the pose is a measurement, the robot stands and sees what
it saw at first; so the scans show which of the two it is as soon as the robot drives.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.recording import Ranges
from moteslam.slam.inputs.config import SyncConfig


def has_moved(odometry: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the odometry [n, 3] has moved by each scan, [n]."""
    return np.logical_or.accumulate((odometry != odometry[0]).any(axis=1))


def stands(
    ranges: Ranges,
    moved: NDArray[np.bool_],
    config: SyncConfig | None = None,
    *,
    before: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """At which scans the robot is seen to stand where it began, before its odometry moves.

    Args:
        ranges: [n, beams] of the scans [m].
        moved: [n] whether the odometry has moved by each.
        config: what counts as another place; the defaults if None.
        before: the result for the first scans of these; a recording that grows is not looked through again.

    Returns:
        [n]; False from the first scan on that differs from scan 0, and where no beam has an endpoint in both.
    """
    c = config or SyncConfig()
    there = np.zeros(len(moved), np.bool_)
    unmoved = int((~moved).sum())
    seen = np.zeros(0, np.bool_) if before is None else before[:unmoved]
    if not len(seen) or not seen[-1]:  # at its end the robot may have left
        seen = seen[:0]
    there[: len(seen)] = seen
    first = ranges[0]
    for scan in range(len(seen), unmoved):
        here = ranges[scan]
        both = np.isfinite(first) & np.isfinite(here)
        differs = np.abs(here[both] - first[both]) > c.same_range
        if differs.sum() > c.moved_share * both.sum():
            break
        there[scan] = both.any()
    return there
