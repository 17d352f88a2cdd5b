"""The motion since the last update, as odometry measured it and as tracking found it."""

from __future__ import annotations

from typing import NamedTuple

from moteslam.robot.se2 import Pose, compose_one
from moteslam.slam.filter.update_policy import Travelled, magnitude
from moteslam.slam.inputs.lapses import CLOSED, Open

__all__ = ["CLOSED", "MotionSinceUpdate", "Open", "StepMotion", "Travelled", "magnitude", "step_motion"]

STILL: Pose = (0.0, 0.0, 0.0)
"""No motion."""


class StepMotion(NamedTuple):
    """The motion of one step, before its scan is registered.

    Attributes:
        wheels: as the odometry measured it, or as extrapolated.
        corrected: the same with the odometry's systematic errors removed.
        dt: of the step [s].
        measured: whether odometry measured it.
        distance, rotation: length and absolute turn of ``corrected`` [m], [rad].
        open: how far off one may be that odometry bounds but did not measure.
    """

    wheels: Pose
    corrected: Pose
    dt: float
    measured: bool
    distance: float
    rotation: float
    open: Open = CLOSED


def step_motion(wheels: Pose, corrected: Pose, dt: float, *, measured: bool, left: Open = CLOSED) -> StepMotion:
    """The motion of one step: see ``StepMotion``."""
    return StepMotion(wheels, corrected, dt, measured, *magnitude(corrected), left)


class MotionSinceUpdate(NamedTuple):
    """The sum of the steps since the last update; every increment is in the frame of the pose there.

    Attributes:
        tracked: as registration to the best particle's map found it.
        odometry: by the corrected odometry; by tracking where the odometry slipped or measured nothing.
        wheels: by the odometry, not corrected.
        travelled: distance, rotation and time by the corrected odometry.
        calibrates: whether the odometry's gains may be updated with it: no part of it is extrapolated or a slip.
    """

    tracked: Pose = STILL
    odometry: Pose = STILL
    wheels: Pose = STILL
    travelled: Travelled = Travelled()
    calibrates: bool = True

    def plus(self, step: StepMotion, tracked: Pose, *, slipped: bool) -> MotionSinceUpdate:
        """After one more step.

        Args:
            slipped: whether its odometry slipped.
        """
        usable = step.measured and not slipped
        return MotionSinceUpdate(
            tracked=compose_one(self.tracked, tracked),
            odometry=compose_one(self.odometry, step.corrected if usable else tracked),
            wheels=compose_one(self.wheels, step.wheels),
            travelled=self.travelled.plus(step.distance, step.rotation, step.dt),
            calibrates=self.calibrates and usable,
        )
