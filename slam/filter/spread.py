"""How far the particles are apart: the filter's own measure of its uncertainty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2


def spread(poses: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """The weighted standard deviations [3] of particles: along and across the mean heading [m], of the heading [rad].

    Args:
        poses: [N, 3] of the particles.
        weights: [N], with sum 1.
    """
    if len(poses) == 1:
        return np.zeros(3)
    x, y = weights @ poses[:, :2]
    heading = np.arctan2(weights @ np.sin(poses[:, 2]), weights @ np.cos(poses[:, 2]))
    deviations = se2.between(np.array((x, y, heading)), poses)
    return np.asarray(np.sqrt(weights @ np.square(deviations)))
