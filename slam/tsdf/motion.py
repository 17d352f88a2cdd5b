"""The motion since the last update, as odometry measured it and as tracking found it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.filter.update_policy import Travelled, magnitude

__all__ = ["MotionSinceUpdate", "StepMotion", "Travelled", "magnitude"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StepMotion:
    """The motion of one step, before its scan is registered.

    Attributes:
        wheels: [3] as the odometry measured it, or as extrapolated.
        corrected: [3] the same with the odometry's systematic errors removed.
        dt: of the step [s].
        measured: whether odometry measured it.
    """

    wheels: Array
    corrected: Array
    dt: float
    measured: bool


@dataclass(frozen=True, eq=False)
class MotionSinceUpdate:
    """The sum of the steps since the last update; every increment is in the frame of the pose there.

    Attributes:
        tracked: [3] as registration to the best particle's map found it.
        odometry: [3] by the corrected odometry; by tracking where the odometry slipped or measured nothing.
        wheels: [3] by the odometry, not corrected.
        travelled: distance, rotation and time by the corrected odometry.
        calibrates: whether the odometry's gains may be updated with it: no part of it is extrapolated or a slip.
    """

    tracked: Array = field(default_factory=lambda: np.zeros(3))
    odometry: Array = field(default_factory=lambda: np.zeros(3))
    wheels: Array = field(default_factory=lambda: np.zeros(3))
    travelled: Travelled = field(default_factory=Travelled)
    calibrates: bool = True

    def plus(self, step: StepMotion, tracked: Array, *, slipped: bool) -> MotionSinceUpdate:
        """After one more step.

        Args:
            step: as it was predicted.
            tracked: [3] the same as registration found it.
            slipped: whether its odometry slipped.
        """
        usable = step.measured and not slipped
        return MotionSinceUpdate(
            tracked=se2.compose(self.tracked, tracked),
            odometry=se2.compose(self.odometry, step.corrected if usable else tracked),
            wheels=se2.compose(self.wheels, step.wheels),
            travelled=self.travelled.plus(step.corrected, step.dt),
            calibrates=self.calibrates and usable,
        )
