"""Degenerate directions: where a scan carries next to no information, the odometry is kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.degeneracy import keep_predictions
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import FULL, Registration, kept_by

Array = NDArray[np.float64]
UPPER = [0, 1, 2, 4, 5, 8]
"""The upper triangle of a 3 x 3 matrix, of its elements row by row."""


def least_informed(information: Array) -> tuple[Array, Array]:
    """The direction in the plane that endpoints carry least information about.

    Args:
        information: [N, 3, 3] of the pose (x, y, theta).

    Returns:
        [N] the ratio of the information along it to that across it, and [N, 2] the direction as a unit vector.
    """
    xx, xy, yy = information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]
    middle, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    most = np.arctan2(2 * xy, xx - yy) / 2
    along = np.empty((len(most), 2))
    along[:, 0], along[:, 1] = -np.sin(most), np.cos(most)
    return (middle - half) / np.maximum(middle + half, 1e-9), along


def keep_odometry(found: Registration, spread: Array, config: RegistrationConfig) -> Registration:
    """What registration found, with the odometry kept along a degenerate direction.

    Along the least informed direction the offset is scaled by the weight of the registration against the odometry;
    information along it is scaled likewise.

    Args:
        found: of N particles.
        spread: [3] standard deviation of the odometry.
        config: how much error a degenerate direction has.
    """
    offsets, information = keep_predictions(
        found.offsets, found.information.reshape(-1, 9)[:, UPPER], kept_by(float(spread[0]), config)
    )
    return found._replace(offsets=offsets, information=information[:, FULL].reshape(-1, 3, 3))
