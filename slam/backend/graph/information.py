"""The information of a registration, by what its own residuals are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import Registration

Array = NDArray[np.float64]

LIKELIHOODS = (0.2, 0.98)
"""Mean likelihoods that residuals are estimated from: beyond these they say nothing."""


def measured_information(found: Registration, which: int, config: RegistrationConfig, correlation: float) -> Array:
    """The information [3, 3] of a registration, about its offset.

    The residuals' variance is not a setting: it follows from the mean likelihood of the endpoints. With normal
    residuals of variance t^2 the mean of exp(-(r / width)^2 / 2) is 1 / sqrt(1 + (t / width)^2).

    Args:
        found: of N particles or starts.
        which: one of them.
        config: that it was registered with.
        correlation: neighbouring endpoints err alike: this many of them count as one.
    """
    mean = float(np.clip(found.likelihoods[which], *LIKELIHOODS))
    variance = config.likelihood_width**2 * (1 / mean**2 - 1)  # in squares of config.residual, as the information is
    return np.asarray(found.information[which] / (variance * correlation))
