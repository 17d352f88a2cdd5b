"""What one step of a filter came to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Outcome(NamedTuple):
    """What one step came to.

    Attributes:
        pose: [3] of the robot: the best particle's, or the mean of those that believe the same.
        motion: [3] since the scan before, as the filter knows it now, in the frame of the pose there.
        n_eff: effective number of particles, before resampling.
        score: of the best particle: endpoints on occupied cells, or how likely they are in the mean.
        updated: the filter worked on this scan; else the pose followed the motion.
        resampled: particles were resampled.
    """

    pose: NDArray[np.float64]
    motion: NDArray[np.float64]
    n_eff: float
    score: float
    updated: bool
    resampled: bool
