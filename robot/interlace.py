"""Interlaced lidars: a scan measures every k-th bearing of a grid, and begins at another one each time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def phases(ranges: NDArray[np.float32], interlace: int) -> NDArray[np.intp]:
    """At which beam scans begin [n], from 0 to below ``interlace``; 0 for a scan of which nothing is known.

    Args:
        ranges: [n, beams] [m]; ``nan`` where a scan measured nothing.
        interlace: of the lidar, see `LidarStream`.
    """
    if interlace == 1:
        return np.zeros(len(ranges), np.intp)
    known = ~np.isnan(ranges)
    begins = np.stack([known[:, phase::interlace].any(axis=1) for phase in range(interlace)])
    return np.asarray(begins.argmax(axis=0))


def measured(ranges: NDArray[np.float32], interlace: int) -> NDArray[np.bool_]:
    """Which beams [n, beams] scans measured, usable reading or not.

    Args:
        ranges, interlace: as of ``phases``.
    """
    return np.asarray(np.arange(ranges.shape[1]) % interlace == phases(ranges, interlace)[:, None])
