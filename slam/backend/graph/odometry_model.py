"""The odometry's own errors, as measured by registration: what is systematic is taken out, the rest is its noise."""

from typing import NamedTuple

import numpy as np

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.odometry.calibration import aside

AT_REST = np.array([0.005, 0.005, 0.005])
"""The shape of the noise before it is scaled to what is measured: [m], [m], [rad] ..."""
FROM_DISTANCE = np.array([0.05, 0.05, 0.02])  # ... and for every metre ...
FROM_ROTATION = np.array([0.02, 0.02, 0.05])  # ... and for every radian
ROUNDS = 8  # Of fitting gains and scales alternately
TAIL = 4.0  # Squared robust scale of the fit [variances] (Cauchy)
KNOWN, FEWEST = 2.0, 10
"""The noise is measured on steps whose registration has less than the first factor times the odometry's variance, where
there are more than the second."""
GAIN_INFORMATION = 200.0
"""Prior on the gains, of standard deviation 0.07: wheels are off by some percent (docs/theory/default-filter.md),
or not at all, which is as probable."""
MOST_ODDS = 20.0  # Of a gain that is 0, and of one that is not [nats]
LEAST_SCALE = 0.1  # Of the noise, over its shape: no odometry is better
LEAST_SHARE = 0.1  # Of that noise is the odometry's own, at least
SAFETY = 2.0  # Factor on the measured standard deviation: errors of neighbouring steps are alike
NORMAL_MAD = 1.4826  # A normal distribution's standard deviation over its median absolute deviation


class OdometryModel(NamedTuple):
    gains: Array  # [3, 3] of forward, left and turning error for forward, left and turning motion
    scales: Array  # [3] of the noise that is left, over its shape

    def corrected(self, odometry: Array) -> Array:
        """Steps [n, 3] with what is systematic taken out."""
        return se2.compose(odometry, odometry @ self.gains.T)

    def spread(self, odometry: Array) -> Array:
        """The standard deviations [n, 3] of corrected steps."""
        return turned_aside(odometry, SAFETY * self.scales * _shape(odometry))


def turned_aside(odometry: Array, spread: Array) -> Array:
    """Standard deviations [n, 3] of steps [n, 3], with what errors of the heading on the way move the end aside.

    Between two key scans that is next to nothing, after an outage of ten metres more than all else.
    """
    moved = aside(np.abs(odometry[..., 1::-1]), spread[..., 2:])
    return np.concatenate((np.hypot(spread[..., :2], moved), spread[..., 2:]), axis=-1)


def fit_odometry(odometry: Array, registered: Array, covariance: Array) -> OdometryModel:
    """Fit a linear map of each step that corrects it, and measure what noise is left.

    Alternately the gains of forward, left and turning error are fitted, robustly, and the scale of the noise: the
    median absolute residual of the steps that registration knows better than odometry. Both sides err: what is left is
    to be orthogonal not to the steps by the odometry, whose noise is in it, but to the true ones, by odometry and
    registration together (errors in variables; Fuller 1987, Measurement Error Models, section 1.3).

    ``odometry``, ``registered``: [n - 1, 3] steps; covariance: [n - 1, 3, 3] of the registered ones.
    """
    errors = se2.between(odometry, registered)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    gains, scales, true = np.zeros((3, 3)), np.ones(3), odometry + errors
    measured, believed = np.zeros(3, bool), np.ones((3, 3))
    for _ in range(ROUNDS):
        shape = _shape(true)
        noises = np.square(scales * shape)
        own = np.maximum(noises - variance, LEAST_SHARE * noises)  # what is measured below is that of both
        true = odometry + errors - variance / (variance + own) * (errors - odometry @ gains.T)
        for axis in range(3):
            noise = noises[:, axis]
            rest = errors[:, axis] - odometry @ gains[axis]
            total = variance[:, axis] + noise
            weights = 1 / total / (1 + rest * rest / total / TAIL)
            weighted = true * weights[:, None]
            prior = GAIN_INFORMATION / believed[axis]  # of the mixture's variance
            left = np.linalg.inv(weighted.T @ odometry + np.diag(prior))
            gains[axis] = left @ (weighted.T @ errors[:, axis])
            believed[axis] = _belief(gains[axis] / np.diag(left), 1 / np.diag(left) - prior)
            rest = errors[:, axis] - odometry @ gains[axis]
            known = variance[:, axis] < KNOWN * noise
            if known.sum() > FEWEST:  # of less noise fewer steps are known: what was measured stands then
                measured[axis] = True
                scales[axis] = max(NORMAL_MAD * float(np.median(np.abs(rest[known]) / shape[known, axis])), LEAST_SCALE)
        if measured.any():  # along bare walls: no worse than where it can be measured
            scales[~measured] = scales[measured].max()
    return OdometryModel(gains, scales)


def _belief(weighted: Array, information: Array) -> Array:
    """How probable [n] it is that gains are not 0, by the evidence of either (Bayes factor).

    ``weighted``: [n] what the steps alone say, times its information [n].
    """
    both = np.maximum(information, 0) + GAIN_INFORMATION
    odds = np.square(weighted) / both / 2 - np.log(both / GAIN_INFORMATION) / 2
    return np.asarray(1 / (1 + np.exp(-np.clip(odds, -MOST_ODDS, MOST_ODDS))))


def _shape(odometry: Array) -> Array:
    """The noise [n, 3] of steps before it is scaled."""
    distance, rotation = np.hypot(odometry[:, 0], odometry[:, 1])[:, None], np.abs(odometry[:, 2])[:, None]
    return np.asarray(AT_REST + FROM_DISTANCE * distance + FROM_ROTATION * rotation)
