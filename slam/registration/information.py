"""The information of a registration, by what its own residuals are, and the motions that its endpoints do not bind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.gauss_newton import LEAST_INFORMATION, LEAST_RATIO, NOISE_RATIO, RIDGE, keep_predictions
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


def unbound(information: Array, means: Array, variances: Array, error: float) -> tuple[Array, Array]:
    """The two motions that endpoints bind least, and how far registration errs along them, as ``keep_predictions``.

    Args:
        information: [N, 3, 3] of the pose (x, y, theta).
        means: [N, 3] of the endpoints' x, y, x^2 + y^2 from the robot, in the axes of the information [m, m^2].
        variances: [N] of the residuals, in squares of standard ones.
        error: along a direction that is informed as well as the one across [m].

    Returns:
        [N, 2, 3] a unit vector in the plane, and a turn of a radian about a centre; [N, 2] standard deviations of the
        share of each.
    """
    ratio, along = least_informed(information)
    plane = information[:, :2, :2]
    total = np.maximum(np.trace(plane, axis1=1, axis2=2), LEAST_INFORMATION)
    bound = plane + RIDGE * total[:, None, None] * np.eye(2)
    turn = np.ones((len(information), 3))
    turn[:, :2] = -np.linalg.solve(bound, information[:, :2, 2:])[..., 0]
    x, y, _ = turn.T
    lever = np.maximum(means[:, 2] + x * x + y * y + 2 * (y * means[:, 0] - x * means[:, 1]), LEAST_INFORMATION)
    known = np.einsum("ni,nij,nj->n", turn, information, turn)
    ratios = np.column_stack((ratio, known / (total * lever) - NOISE_RATIO * variances))
    deviations = (error * variances)[:, None] / np.maximum(ratios, LEAST_RATIO)
    deviations[:, 1] /= np.sqrt(lever)
    return np.stack((np.column_stack((along, np.zeros(len(along)))), turn), axis=1), deviations


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
        np.ones(len(found.offsets)),
        kept_by(float(spread[0]), float(spread[2]), config),
    )
    return found._replace(offsets=offsets, information=information[:, FULL].reshape(-1, 3, 3))


def less_where_unbound(information: Array, found: Registration, which: int, config: RegistrationConfig) -> Array:
    """Information [3, 3] of a registration with its errors along the motions that the endpoints bind least.

    Along bare walls, and for turns in a round room, it is wrong by errors of the map, not by the endpoints' noise: by
    as much as ``keep_predictions`` has it.

    Args:
        information: as of ``measured_information``.
        found, which, config: as there.
    """
    variance = np.array([residual_variance(float(found.likelihoods[which]), config)])
    seen = found.at(which)
    (motions,), (errors,) = unbound(seen.information, seen.means, variance, config.degenerate)
    for motion, error in zip(motions, errors, strict=True):
        if error:
            known = information @ motion
            information = information - np.outer(known, known) / (1 / error**2 + known @ motion)
    return np.asarray(information)
