"""The information of a registration, by what its own residuals are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.gauss_newton import LEAST_RATIO
from moteslam.kernels.registration import LIKELIHOODS
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import Registration, least_informed

Array = NDArray[np.float64]


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


def less_along_bare_walls(information: Array, found: Registration, which: int, config: RegistrationConfig) -> Array:
    """Information [3, 3] of a registration with its error along the direction that the endpoints bind least.

    Along bare walls it is wrong by errors of the map, not by the endpoints' noise: by ``config.degenerate`` over the
    ratio of the information along the walls to that across, times the variance of the residuals, as ``keep_prediction``
    has it.

    Args:
        information: as of ``measured_information``.
        found, which, config: as there.
    """
    (ratio,), (along,) = least_informed(found.information[which : which + 1])
    variance = residual_variance(float(found.likelihoods[which]), config)
    error = config.degenerate * variance / max(float(ratio), LEAST_RATIO)
    known = information @ np.append(along, 0.0)
    return (
        np.asarray(information - np.outer(known, known) / (1 / error**2 + known[:2] @ along)) if error else information
    )
