"""The information of a registration, by what its own residuals are, and the motions that its endpoints do not bind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.gauss_newton import (
    LEAST_INFORMATION,
    LEAST_SHARE,
    MOST_NOISE,
    NOISE_SHARE,
    keep_predictions,
)
from moteslam.kernels.registration import LIKELIHOODS
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import FULL, Registration, kept_by

Array = NDArray[np.float64]
UPPER = [0, 1, 2, 4, 5, 8]
"""The upper triangle of a 3 x 3 matrix, of its elements row by row."""


def residual_variance(likelihood: float, config: RegistrationConfig) -> float:
    """The variance of the endpoints' residuals by their mean likelihood, in squares of ``config.residual``.

    It is no setting: with normal residuals of variance t^2 the mean of exp(-(r / width)^2 / 2) is
    1 / sqrt(1 + (t / width)^2).

    Args:
        likelihood: mean of the endpoints, 0 to 1.
        config: that they were registered with.
    """
    mean = min(max(likelihood, LIKELIHOODS[0]), LIKELIHOODS[1])
    return config.likelihood_width**2 * (1 / mean**2 - 1)


def measured_information(found: Registration, which: int, config: RegistrationConfig, correlation: float) -> Array:
    """The information [3, 3] of a registration, about its offset, by the variance of its own residuals.

    Args:
        found: of N particles or starts.
        which: one of them.
        config: that it was registered with.
        correlation: neighbouring endpoints err alike: this many of them count as one.
    """
    variance = residual_variance(float(found.likelihoods[which]), config)
    return np.asarray(found.information[which] / (variance * correlation))


def least_bound(information: Array, means: Array) -> tuple[Array, Array]:
    """The motion that endpoints bind least: as in ``keep_predictions``.

    Args:
        information: [N, 3, 3] of the pose (x, y, theta).
        means: [N, 3] of the endpoints' x, y, x^2 + y^2 from the robot, in the axes of the information [m, m^2].

    Returns:
        [N] the share of the information that it has, and [N, 3] it: a turn about a centre among the endpoints, or else
        a way of 1 m.
    """
    x, y, square = means.T
    lever = np.sqrt(np.maximum(square - x * x - y * y, LEAST_INFORMATION))
    total = np.maximum(information[:, 0, 0] + information[:, 1, 1], LEAST_INFORMATION)
    motions = np.zeros_like(information)  # in the columns: of the endpoints' mean, and a turn about it
    motions[:, 0, 0] = motions[:, 1, 1] = 1
    motions[:, :, 2] = np.column_stack((y, -x, np.ones(len(x)))) / lever[:, None]
    values, vectors = np.linalg.eigh(np.swapaxes(motions, 1, 2) @ information @ motions)
    motion = (motions @ vectors[:, :, :1])[:, :, 0]
    way = np.square(motion[:, :2]).sum(axis=1) >= square * np.square(motion[:, 2])
    xx, xy, yy = information[way, 0, 0], information[way, 0, 1], information[way, 1, 1]
    most = np.arctan2(2 * xy, xx - yy) / 2  # heading of the most informed direction
    motion[way] = np.column_stack((-np.sin(most), np.cos(most), np.zeros(len(most))))
    return np.maximum(values[:, 0] / total, LEAST_SHARE), motion


def boundness(shares: Array, variances: Array) -> Array:
    """From 1, where a motion with this share of the information is bound, to 0, where that is noise of the slopes.

    Args:
        shares: [N] of ``least_bound``.
        variances: [N] of the residuals, in squares of standard ones.
    """
    return np.clip(2 * shares / (NOISE_SHARE * np.minimum(variances, MOST_NOISE)) - 2, 0.0, 1.0)


def keep_odometry(found: Registration, spread: Array, config: RegistrationConfig) -> Registration:
    """What registration found, with the odometry kept along what the endpoints do not bind: ``keep_predictions``.

    Args:
        found: of N particles.
        spread: [3] standard deviation of the odometry.
        config: how much error a degenerate direction has.
    """
    offsets, information = keep_predictions(
        found.offsets,
        found.information.reshape(-1, 9)[:, UPPER],
        found.means,
        kept_by(float(spread[0]), config),
    )
    return found._replace(offsets=offsets, information=information[:, FULL].reshape(-1, 3, 3))


def less_where_unbound(information: Array, found: Registration, which: int, config: RegistrationConfig) -> Array:
    """Information [3, 3] of a registration with its errors along the way that the endpoints bind least.

    Along bare walls it is wrong by errors of the map, not by the endpoints' noise: by as much as ``keep_predictions``
    has it. A turn that is not bound is taken out there already.

    Args:
        information: as of ``measured_information``.
        found, which, config: as there.
    """
    seen = found.at(which)
    (share,), (motion,) = least_bound(seen.information, seen.means)
    error = config.degenerate * residual_variance(float(seen.likelihoods[0]), config) / float(share)
    if error and not motion[2]:  # a turn is taken out where the odometry is kept
        known = information @ motion
        information = information - np.outer(known, known) / (1 / error**2 + known @ motion)
    return np.asarray(information)
