"""Scans thinned to about as many points as matching and mapping need, whatever the lidar."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.thinning import ThinnedScan, thin_scan
from moteslam.slam.inputs.config import ThinningConfig


def thin(points: NDArray[np.float32], origin: NDArray[np.float64], config: ThinningConfig) -> ThinnedScan:
    """Average neighbouring endpoints.

    Args:
        points: [k, 2] in the order of their beams, in the robot's frame [m].
        origin: [2] where the rays start [m].
        config: distances and counts.
    """
    return thin_scan(
        points,
        origin,
        spacing=config.spacing,
        max_spacing=config.max_spacing,
        max_points=config.max_points,
        gap=config.gap,
        gap_from_range=config.gap_from_range,
    )
