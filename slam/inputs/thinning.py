"""Scans thinned to about as many points as matching and mapping need, whatever the lidar."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.thinning import ThinnedScan, thin_scan, thin_scans
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.inputs.scans import ScanBlock, Scans

BLOCK = 64
"""Scans that are projected and thinned at a time: of 1081 beams 0.5 MB."""


def thin(points: NDArray[np.float32], origin: NDArray[np.float64], config: ThinningConfig) -> ThinnedScan:
    """Average neighbouring endpoints.

    Args:
        points: [k, 2] in the order of their beams, in the robot's frame [m].
        origin: [2] where the rays start [m].
        config: distances and counts.
    """
    return thin_scan(points, origin, **vars(config))


def thin_block(block: ScanBlock, origin: NDArray[np.float64], config: ThinningConfig) -> list[ThinnedScan]:
    """The scans of a block, thinned in one launch.

    Args:
        block: of scans.
        origin: [2] where the rays start [m].
        config: distances and counts.
    """
    return thin_scans(block.points, block.begins, block.counts, origin, **vars(config))


def thin_some(scans: Scans, indices: Sequence[int], config: ThinningConfig) -> list[ThinnedScan]:
    """Some of the scans, each as by ``thin``, ``BLOCK`` in a launch.

    Args:
        scans: all.
        indices: [m] of those to thin.
        config: distances and counts.
    """
    thinned: list[ThinnedScan] = []
    for first in range(0, len(indices), BLOCK):
        points = [scans.points(index) for index in indices[first : first + BLOCK]]
        counts = np.array([len(each) for each in points], np.int32)
        begins = np.cumsum(counts, dtype=np.int32) - counts
        thinned += thin_block(ScanBlock(np.concatenate(points), begins, counts), scans.origin, config)
    return thinned
