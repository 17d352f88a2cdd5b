"""How uncertain a motion is: the noise that prediction adds, and the errors of odometry."""

from __future__ import annotations

import math
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.values import NotNegative, Section

Lengths = TypeVar("Lengths", float, NDArray[np.float64])


class MotionNoise(Section):
    """Standard deviations of the Gaussian noise that prediction adds to the control (epsilon in II.6, III.3).

    The paper's noise is constant in (v, omega): the first two. The others grow with the motion itself, so that logs
    whose stamps carry no time (equal ones, one a second) spread too (alpha 1 to 4 of Probabilistic Robotics, 5.3).
    """

    velocity: NotNegative = 0.0
    """Noise on the velocity [m/s]."""
    yaw_rate: NotNegative = 0.0
    """Noise on the yaw rate [rad/s]."""
    translation_from_translation: NotNegative = 0.0
    """Noise along the path, as a share of the distance [m/m] (alpha 3)."""
    translation_from_rotation: NotNegative = 0.0
    """Noise of the position for a turn [m/rad] (alpha 4)."""
    rotation_from_translation: NotNegative = 0.0
    """Noise of the heading for a distance [rad/m] (alpha 2)."""
    rotation_from_rotation: NotNegative = 0.0
    """Noise of the heading, as a share of the turn [rad/rad] (alpha 1)."""


class OdometryNoise(Protocol):
    """Standard deviations of odometry that grow linearly with the motion."""

    @property
    def translation(self) -> float:
        """At rest [m]."""

    @property
    def translation_from_translation(self) -> float:
        """For every metre [m/m]."""

    @property
    def rotation(self) -> float:
        """At rest [rad]."""

    @property
    def rotation_from_rotation(self) -> float:
        """For every radian [rad/rad]."""


def prediction_noise(noise: MotionNoise, distance: float, rotation: float, elapsed: float) -> NDArray[np.float64]:
    """The standard deviations of one prediction: forward [m], left [m], turn [rad].

    One epsilon is drawn for the interval between two updates of the filter, so the noise does not depend on how often
    the sensors report in between. The shares of the motion itself are those of Probabilistic Robotics, table 5.6; to
    the left, where the robot does not drive on purpose, it slips with the turn alone.

    Args:
        distance: travelled since the last update [m].
        rotation: the sum of absolute turns since [rad].
        elapsed: since [s]; 0 is allowed.
    """
    slip = noise.translation_from_rotation * rotation
    forward = np.hypot(noise.velocity * elapsed, noise.translation_from_translation * distance)
    heading = np.hypot(noise.yaw_rate * elapsed, noise.rotation_from_translation * distance)
    return np.array([np.hypot(forward, slip), slip, np.hypot(heading, noise.rotation_from_rotation * rotation)])


def aside(distance: Lengths, heading: Lengths) -> Lengths:
    """The standard deviation of a position to the side of a motion [m], by an error of the heading on it.

    An error that grows evenly with the distance turns the end about the beginning by a third of its variance.

    Args:
        distance: of the motion [m].
        heading: standard deviation of the heading at its end [rad].
    """
    return distance * heading / math.sqrt(3)


def odometry_error(noise: OdometryNoise, distance: float, rotation: float) -> tuple[float, float, float]:
    """The standard deviations of a motion that odometry measured: forward [m], left [m], turn [rad].

    Args:
        distance: [m].
        rotation: the sum of absolute turns [rad].
    """
    translation = noise.translation + noise.translation_from_translation * distance
    return translation, translation, noise.rotation + noise.rotation_from_rotation * rotation
