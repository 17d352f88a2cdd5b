"""Prediction: every particle moves by the control, with noise (III.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.motion import sample_motion
from moteslam.slam.filter.update_policy import Travelled
from moteslam.slam.odometry.config import MotionNoise
from moteslam.slam.odometry.noise import prediction_noise


def predict(
    poses: NDArray[np.float64],
    motion: NDArray[np.float64],
    travelled: Travelled,
    noise: MotionNoise,
    *,
    seed: int,
    step: int,
) -> None:
    """Move the particles in place.

    Args:
        poses: [N, 3]; written to.
        motion: [3] since the last update.
        travelled: how much that is.
        noise: of the control.
        seed, step: of the draws.
    """
    spread = prediction_noise(noise, travelled.distance, travelled.rotation, travelled.elapsed)
    sample_motion(poses, motion, spread, seed=seed, step=step)
