"""Which scans a filter works on: those that the robot has moved, turned or waited enough for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.config import UpdateConfig
from moteslam.slam.step import Step


class UpdateGate:
    """Adds up the motion since the last update.

    Args:
        config: when an update is due.

    Attributes:
        travelled: length of the way [m]; turned: sum of the absolute turns [rad]; elapsed: [s].
    """

    def __init__(self, config: UpdateConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """An update has been made."""
        self.travelled = self.turned = self.elapsed = 0.0

    def add(self, step: Step) -> None:
        """Take in the motion of a step."""
        travelled, turned = extent(step.motion)
        self.travelled += travelled
        self.turned += turned
        self.elapsed += step.dt

    def due(self, motion: NDArray[np.float64] | None = None) -> bool:
        """Whether an update is.

        Args:
            motion: [3] what is known of the motion since the last update by other means than the steps.
        """
        travelled, turned = self.travelled, self.turned
        if motion is not None:
            travelled, turned = np.maximum((travelled, turned), extent(motion)).tolist()
        c = self._config
        return travelled >= c.distance or turned >= c.rotation or self.elapsed >= c.interval


def extent(motion: NDArray[np.float64]) -> tuple[float, float]:
    """How far [m], and how much of a turn [rad], a motion [3] is."""
    return float(np.hypot(motion[0], motion[1])), abs(float(motion[2]))
