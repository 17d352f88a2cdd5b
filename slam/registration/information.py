"""The information of a registration, by what its own residuals are, and the motions that its endpoints do not bind."""

from __future__ import annotations

import numpy as np

from moteslam.kernels.gauss_newton import LEAST_INFORMATION, LEAST_RATIO, MOST_NOISE, NOISE_RATIO, RIDGE, Kept
from moteslam.kernels.gauss_newton import keep_predictions as kept
from moteslam.kernels.registration import LIKELIHOODS
from moteslam.robot.se2 import Array
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import FULL, Registration

UPPER = [0, 1, 2, 4, 5, 8]  # The upper triangle of a 3 x 3 matrix, of its elements row by row


def residual_variance(likelihood: float, config: RegistrationConfig) -> float:
    """The variance of the endpoints' residuals by their mean likelihood, in squares of ``config.residual``.

    It is no setting: with normal residuals of variance t^2 the mean of exp(-(r / width)^2 / 2) is
    1 / sqrt(1 + (t / width)^2).
    """
    mean = min(max(likelihood, LIKELIHOODS[0]), LIKELIHOODS[1])
    return config.likelihood_width**2 * (1 / mean**2 - 1)


def measured_information(found: Registration, which: int, config: RegistrationConfig, correlation: float) -> Array:
    """The information [3, 3] of one registration, about its offset, by the variance of its own residuals.

    Neighbouring endpoints err alike: ``correlation`` of them count as one.
    """
    variance = residual_variance(float(found.likelihoods[which]), config)
    return np.asarray(found.information[which] / (variance * correlation))


def least_informed(information: Array) -> tuple[Array, Array]:
    """The direction in the plane that information [N, 3, 3] of poses (x, y, theta) is least along.

    Returns [N] the ratio of the information along it to that across it, and [N, 2] the direction as a unit vector.
    """
    xx, xy, yy = information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]
    middle, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    most = np.arctan2(2 * xy, xx - yy) / 2
    along = np.empty((len(most), 2))
    along[:, 0], along[:, 1] = -np.sin(most), np.cos(most)
    return (middle - half) / np.maximum(middle + half, 1e-9), along


def least_bound_turn(
    information: Array, means: Array, variances: Array, errors: Array, config: RegistrationConfig
) -> tuple[Array, Array]:
    """The turn that changes the endpoints' distances least, and how much they know of it: as ``keep_predictions``.

    Args:
        information: [N, 3, 3] of the pose (x, y, theta).
        means: [N, 3] of the endpoints' x, y, x^2 + y^2 from the robot, in the axes of the information [m, m^2].
        variances: [N] of the residuals, in squares of standard ones.
        errors: [N] along the direction that is bound least [m]: where they are large a turn does not move along it.

    Returns [N, 3] how the robot moves in a turn of a radian; [N] 1 where it is bound, 0 where that is noise of the
    slopes.
    """
    ratio, along = least_informed(information)
    weight = 1 / (1 + np.square(errors / config.translation))
    total = np.maximum(information[:, 0, 0] + information[:, 1, 1], LEAST_INFORMATION)
    least = total * np.maximum(ratio, 0.0) / (1 + ratio)
    across = np.column_stack((along[:, 1], -along[:, 0]))
    pull, push = ((information[:, :2, 2] * way).sum(axis=1) for way in (along, across))
    turn = np.ones((len(information), 3))
    turn[:, :2] = -(weight * pull / (least + RIDGE * total))[:, None] * along
    turn[:, :2] -= (push / (total - least + RIDGE * total))[:, None] * across
    x, y, _ = turn.T
    lever = np.maximum(means[:, 2] + x * x + y * y + 2 * (y * means[:, 0] - x * means[:, 1]), LEAST_INFORMATION)
    known = np.einsum("ni,nij,nj->n", turn, information, turn) / (total * lever)
    return turn, np.clip(2 * known / (NOISE_RATIO * np.minimum(variances, MOST_NOISE)) - 2, 0.0, 1.0)


def keep_odometry(found: Registration, spread: Array, config: RegistrationConfig) -> Registration:
    """What registration found, with odometry of a ``spread`` [3] kept along what the endpoints do not bind.

    See ``keep_predictions``.
    """
    upper = found.information.reshape(-1, 9)[:, UPPER]
    offsets, information = kept(found.offsets, upper, found.means, Kept(float(spread[0]), config.degenerate))
    return found._replace(offsets=offsets, information=information[:, FULL].reshape(-1, 3, 3))


def less_where_unbound(information: Array, found: Registration, which: int, config: RegistrationConfig) -> Array:
    """Information [3, 3] of a registration with its errors along the motions that the endpoints bind least.

    Along bare walls, and for turns in a round room, it is wrong by errors of the map, not by the endpoints' noise: by
    as much as ``keep_predictions`` has it.
    """
    seen = found.at(which)
    (ratio,), (along,) = least_informed(seen.information)
    variance = residual_variance(float(seen.likelihoods[0]), config)
    error = config.degenerate * variance / max(float(ratio), LEAST_RATIO)
    if error:
        known = information @ np.append(along, 0.0)
        information = information - np.outer(known, known) / (1 / error**2 + known[:2] @ along)
        (turn,), (bound,) = least_bound_turn(
            seen.information, seen.means, np.array([variance]), np.array([error]), config
        )
        known = information @ turn
        information = information - (1 - bound) * np.outer(known, known) / max(float(known @ turn), LEAST_INFORMATION)
    return np.asarray(information)
