"""Which scans a filter updates its particles with: those that the robot has moved, turned or waited enough for."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.filter.config import UpdateConfig


class Travelled(NamedTuple):
    """How much the robot has moved since the last update.

    Attributes:
        distance: sum of the distances of all steps [m].
        rotation: sum of their absolute turns [rad].
        elapsed: time [s].
    """

    distance: float = 0.0
    rotation: float = 0.0
    elapsed: float = 0.0

    def plus(self, motion: NDArray[np.float64], dt: float) -> Travelled:
        """After one more step: its motion [3] and its time [s]."""
        distance, rotation = magnitude(motion)
        return Travelled(self.distance + distance, self.rotation + rotation, self.elapsed + dt)


def update_due(policy: UpdateConfig, travelled: Travelled, motion: NDArray[np.float64] | None = None) -> bool:
    """Whether the next scan is used for an update.

    Args:
        policy: when it is.
        travelled: since the last update.
        motion: [3] the motion since the last update where it is also estimated by other means than the odometry; the
            larger of both counts.
    """
    distance, rotation = travelled.distance, travelled.rotation
    if motion is not None:
        length, turn = magnitude(motion)
        distance, rotation = max(distance, length), max(rotation, turn)
    return distance >= policy.distance or rotation >= policy.rotation or travelled.elapsed >= policy.interval


def magnitude(motion: NDArray[np.float64]) -> tuple[float, float]:
    """The length [m] and the absolute turn [rad] of a motion [3]."""
    x, y, turn = motion.tolist()
    return math.hypot(x, y), abs(turn)
