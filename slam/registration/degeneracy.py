"""Degenerate directions: where a scan carries next to no information, the odometry is kept.

Between two bare walls a few endpoints pull along them, by errors of the map rather than by where the robot is (Zhang,
Kaess and Singh 2016, On degeneracy of optimization-based state estimation problems).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import Registration

Array = NDArray[np.float64]
IDENTITY = np.eye(3)[None]


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
    ratio, along = least_informed(found.information)
    error = config.degenerate / np.maximum(ratio, 1e-12)
    offsets, information, usual = found.offsets.copy(), found.information, float(spread[0])
    shift = (along * offsets[:, :2]).sum(axis=1)
    weight = usual**2 / (usual**2 + error * error)
    weight[abs(shift) > config.degenerate_gate * usual] = 1.0
    offsets[:, :2] -= along * ((1 - weight) * shift)[:, None]
    keep = np.repeat(IDENTITY, len(along), axis=0)
    keep[:, :2, :2] -= ((1 - np.sqrt(weight))[:, None] * along)[:, :, None] * along[:, None, :]
    return found._replace(offsets=offsets, information=keep @ information @ keep)
