"""How far prediction spreads the particles: the noise of one step's motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.config import MotionNoise


def motion_variance(noise: MotionNoise, motion: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """The variance of one step's motion: forward [m^2], left [m^2], turn [rad^2].

    The constant noise in (v, omega) of the paper (II.6) is drawn afresh each interval, so it enters as (sigma dt)^2;
    the shares of the motion itself are those of Probabilistic Robotics, table 5.6. The robot does not slip sideways
    on purpose: to the left it spreads with the turn alone.

    Args:
        noise: standard deviations.
        motion: [3] increment of the pose.
        dt: the interval [s]; 0 is allowed.
    """
    distance, turn = float(np.hypot(motion[0], motion[1])), abs(float(motion[2]))
    forward = (
        (noise.velocity * dt) ** 2
        + (noise.translation_from_translation * distance) ** 2
        + (noise.translation_from_rotation * turn) ** 2
    )
    rotation = (
        (noise.yaw_rate * dt) ** 2
        + (noise.rotation_from_translation * distance) ** 2
        + (noise.rotation_from_rotation * turn) ** 2
    )
    return np.array([forward, (noise.translation_from_rotation * turn) ** 2, rotation])
