"""How uncertain a motion is: the noise that prediction adds, and how far odometry may be off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.config import MotionNoise
from moteslam.slam.surface_config import ProposalConfig, RegistrationConfig


def motion_spread(noise: MotionNoise, travelled: float, turned: float, elapsed: float) -> NDArray[np.float64]:
    """The standard deviations of one prediction: forward [m], left [m], turn [rad].

    One epsilon is drawn for the whole interval between two updates of the filter, so the spread does not depend on
    how often the sensors report in between. The shares of the motion itself are those of Probabilistic Robotics,
    table 5.6; to the left, where the robot does not drive on purpose, it slips with the turn alone.

    Args:
        noise: standard deviations.
        travelled: since the last update [m]; turned: the sum of absolute turns [rad]; elapsed: [s], 0 is allowed.
    """
    slip = noise.translation_from_rotation * turned
    forward = np.hypot(noise.velocity * elapsed, noise.translation_from_translation * travelled)
    rotation = np.hypot(noise.yaw_rate * elapsed, noise.rotation_from_translation * travelled)
    return np.array([np.hypot(forward, slip), slip, np.hypot(rotation, noise.rotation_from_rotation * turned)])


def odometry_spread(
    config: RegistrationConfig | ProposalConfig, travelled: float, turned: float
) -> NDArray[np.float64]:
    """The standard deviations of what odometry tells of a motion: forward [m], left [m], turn [rad].

    Args:
        config: whose ``translation`` and ``rotation`` they are, and how these grow.
        travelled: [m]; turned: the sum of absolute turns [rad].
    """
    along = config.translation + config.translation_from_translation * travelled
    return np.array([along, along, config.rotation + config.rotation_from_rotation * turned])
