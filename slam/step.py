"""The one kind of event that SLAM sees: how the robot moved, and the scan at the end of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Step:
    """One scan and the motion since the scan before.

    Attributes:
        index: of the scan in the recording.
        stamp: of the scan [s].
        dt: time since the scan before [s]; 0 for scans that share a stamp.
        motion: [3] increment of the robot's pose, in the frame of its pose at the scan before.
        points: [k, 2] float32 the finite endpoints in the robot's frame [m].
        origin: [2] where the rays start, in the robot's frame [m]: the lidar.
    """

    index: int
    stamp: float
    dt: float
    motion: NDArray[np.float64]
    points: NDArray[np.float32]
    origin: NDArray[np.float64]
