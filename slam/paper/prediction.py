"""The paper's prediction: every particle moves by the control with noise, and so does the covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.motion import sample_motion
from moteslam.robot import se2
from moteslam.slam.filter.certainty import FLOOR, NEIGHBOURHOOD
from moteslam.slam.filter.covariance import Symmetric, moved, plus_diagonal, symmetric
from moteslam.slam.filter.update_policy import Travelled, magnitude
from moteslam.slam.odometry.noise import MotionNoise, prediction_noise
from moteslam.slam.paper.config import MatchConfig

Array = NDArray[np.float64]
UNKNOWN_SPEED = 0.5
"""Of a robot of which no motion was measured yet: that of a slow walk [m/s]."""


def predict(poses: Array, motion: Array, travelled: Travelled, noise: MotionNoise, *, seed: int, step: int) -> None:
    """Move the particles [N, 3] in place by the motion [3] since the last update."""
    spread = prediction_noise(noise, *travelled)
    sample_motion(poses, motion, spread, seed=seed, step=step)


class ParticleCovariance:
    """Follows the covariance from scan to scan.

    Args:
        motion: noise of the odometry; its variance grows in proportion to distance and turn.
        search: offsets that each particle is tried at: no pose is known better than the steps between them, nor than
            scans resolve it.
    """

    def __init__(self, motion: MotionNoise, search: MatchConfig) -> None:
        self._a_metre, self._a_radian, self._a_second = (
            np.square(prediction_noise(motion, *amount)) for amount in np.eye(3).tolist()
        )
        self._step, self._turn = (
            max(float(np.max(np.diff(offsets), initial=0.0)) ** 2 / 12, least)
            for offsets, least in zip((search.offsets_xy, search.offsets_theta), FLOOR, strict=True)
        )
        self._adrift, self._since, self._speed = 0.0, 0.0, UNKNOWN_SPEED  # [m]; driven since [m]; before [m/s]
        self._spread: Symmetric = (self._step, 0.0, 0.0, self._step, 0.0, self._turn)

    def move(self, motion: se2.Pose, dt: float, *, measured: bool) -> None:
        """Take in a motion that took ``dt`` [s].

        Of one that nothing measured the filter knows nothing: the robot may have driven on as fast as before, and any
        jump of the odometry is made up. That is open until the map around the robot was made after it.
        """
        distance, turn = magnitude(motion)
        x, y, theta = (distance * self._a_metre + turn * self._a_radian + dt * self._a_second).tolist()
        self._spread = plus_diagonal(moved(self._spread, motion), x, y, theta)
        if not measured:
            self._adrift, self._since = self._adrift + max(distance, self._speed * dt), 0.0
            return
        self._speed = distance / dt if dt > 0 else self._speed
        self._since += distance
        self._adrift = self._adrift if self._since < NEIGHBOURHOOD else 0.0

    @property
    def value(self) -> Symmetric:
        """At the last scan."""
        return plus_diagonal(self._spread, self._adrift**2, self._adrift**2, 0.0)

    def update(self, poses: Array, weights: Array, pose: Array) -> None:
        """Take in an update: the particles [N, 3], their weights [N], and the pose [3] that was chosen."""
        off = se2.between(pose, poses)
        spread = symmetric((off * weights[:, None]).T @ off)
        self._spread = plus_diagonal(spread, self._step, self._step, self._turn)
