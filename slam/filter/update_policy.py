"""Which scans a filter updates its particles with: those that the robot has moved, turned or waited enough for."""

import math
from typing import NamedTuple

from moteslam.robot.se2 import Pose
from moteslam.robot.values import NotNegative, Positive, Section


class UpdateConfig(Section):
    """The update policy: a scan is used when the robot has moved this far, turned this much, or this time has passed
    since the last that was; the poses of scans between follow the motion. With zeros every scan is used.
    """

    distance: NotNegative = 0.0  # Distance since the last update [m]
    rotation: NotNegative = 0.0  # Sum of the absolute turns since [rad]
    interval: Positive = 1e9  # Time since [s]


class Travelled(NamedTuple):
    """How much the robot has moved since the last update."""

    distance: float = 0.0  # sum of the distances of all steps [m]
    rotation: float = 0.0  # sum of their absolute turns [rad]
    elapsed: float = 0.0  # time [s]

    def plus(self, distance: float, rotation: float, dt: float) -> "Travelled":
        """After one more step: its distance [m], its absolute turn [rad] and its time [s]."""
        return Travelled(self.distance + distance, self.rotation + rotation, self.elapsed + dt)


def update_due(policy: UpdateConfig, travelled: Travelled, motion: Pose | None = None) -> bool:
    """Whether the next scan is used for an update.

    Where the motion since the last one is also estimated by other means than the odometry the larger of both counts.
    """
    distance, rotation = travelled.distance, travelled.rotation
    if motion is not None:
        length, turn = magnitude(motion)
        distance, rotation = max(distance, length), max(rotation, turn)
    return distance >= policy.distance or rotation >= policy.rotation or travelled.elapsed >= policy.interval


def magnitude(motion: Pose) -> tuple[float, float]:
    """The length [m] and the absolute turn [rad] of a motion."""
    x, y, turn = motion
    return math.hypot(x, y), abs(turn)
