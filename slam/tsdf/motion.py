"""The motion since the last update, as odometry measured it and as tracking found it."""

from __future__ import annotations

from typing import NamedTuple

from moteslam.robot.se2 import Pose, compose_one
from moteslam.slam.filter.update_policy import Travelled, magnitude
from moteslam.slam.inputs.lapses import CLOSED, Open

__all__ = ["CLOSED", "MotionSinceUpdate", "Open", "StepMotion", "Travelled", "magnitude", "step_motion"]

STILL: Pose = (0.0, 0.0, 0.0)  # No motion


class StepMotion(NamedTuple):
    """The motion of one step, before its scan is registered."""

    wheels: Pose  # as the odometry measured it, or as extrapolated
    corrected: Pose  # the same with the odometry's systematic errors removed
    dt: float  # of the step [s]
    measured: bool  # whether odometry measured it
    distance: float  # length of `corrected` [m]
    rotation: float  # its absolute turn [rad]
    open: Open = CLOSED  # how far off one may be that odometry bounds but did not measure


def step_motion(wheels: Pose, corrected: Pose, dt: float, *, measured: bool, left: Open = CLOSED) -> StepMotion:
    """One with its length and turn."""
    return StepMotion(wheels, corrected, dt, measured, *magnitude(corrected), left)


class MotionSinceUpdate(NamedTuple):
    """The sum of the steps since the last update; every increment is in the frame of the pose there."""

    tracked: Pose = STILL  # as registration to the best particle's map found it
    odometry: Pose = STILL  # by the corrected odometry; by tracking where the odometry slipped or measured nothing
    wheels: Pose = STILL  # by the odometry, not corrected
    travelled: Travelled = Travelled()  # distance, rotation and time by the corrected odometry
    calibrates: bool = True  # whether the odometry's gains may learn from it: nothing is extrapolated or a slip

    def plus(self, step: StepMotion, tracked: Pose, *, slipped: bool) -> MotionSinceUpdate:
        """After one more step, whose odometry may have slipped."""
        usable = step.measured and not slipped
        return MotionSinceUpdate(
            tracked=compose_one(self.tracked, tracked),
            odometry=compose_one(self.odometry, step.corrected if usable else tracked),
            wheels=compose_one(self.wheels, step.wheels),
            travelled=self.travelled.plus(step.distance, step.rotation, step.dt),
            calibrates=self.calibrates and usable,
        )
