"""How uncertain a motion is: the noise that prediction adds, and the errors of odometry."""

from __future__ import annotations

import math
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Lengths = TypeVar("Lengths", float, NDArray[np.float64])


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


def aside(distance: Lengths, heading: Lengths) -> Lengths:
    """The standard deviation of a position to the side of a motion [m], by that of the heading at its end [rad].

    An error that grows evenly with the distance [m] turns the end about the beginning by a third of its variance.
    """
    return distance * heading / math.sqrt(3)


def odometry_error(noise: OdometryNoise, distance: float, rotation: float) -> tuple[float, float, float]:
    """The standard deviations of a motion that odometry measured: forward [m], left [m], turn [rad].

    The rotation is the sum of the absolute turns [rad].
    """
    translation = noise.translation + noise.translation_from_translation * distance
    return translation, translation, noise.rotation + noise.rotation_from_rotation * rotation
