"""The covariance of the tracked pose relative to the map around the robot, as its own estimator makes it.

A tracked pose is the mean of registration and odometry, weighted as ``register`` weighs them; so its error is that mean
of the errors of both. How large these are is measured: the registration's by the residuals of the scan, the odometry's
by how far the robot has moved since the map around it was made.
"""

import math
from typing import NamedTuple

from moteslam.robot.se2 import Pose
from moteslam.slam.filter.certainty import FLOOR, NEIGHBOURHOOD
from moteslam.slam.filter.covariance import Symmetric, inverse, moved, plus, plus_diagonal, sandwiched
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import Spread, prior_deviations, residual_variance
from moteslam.slam.tsdf.doubt import ScanFit
from moteslam.slam.tsdf.motion import StepMotion

CORRELATION = 14.0  # So many neighbouring endpoints, which err alike, count as one. By drives of seeds from 200 on
START = (1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8)
"""Of the first pose, from which the map is made: not quite zero, so that there is an inverse."""


class Fit(NamedTuple):
    """A scan as it was registered, as far as certainty goes."""

    information: Symmetric  # of the endpoints, in standard residuals
    likelihood: float  # mean of the endpoints, 0 to 1
    spread: Spread  # standard deviation of the prediction that it was registered with
    scan: ScanFit  # what it contradicts in the map


class PoseCovariance:
    """Follows the covariance from scan to scan.

    The odometry's variance grows in proportion to distance and turn, and is that of ``prior_deviations`` after a metre
    and a radian: errors of a path of many steps, whatever the rate of the scans.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        self._config = config
        forward, _, turn = prior_deviations(config, 1.0, 1.0)
        x, theta = forward * forward, turn * turn
        self._a_metre, self._a_radian = x, theta
        # the error relative to the mean of a path that ends here, whose errors add up as in a random walk
        around = NEIGHBOURHOOD / 3
        self._fresh = (x * around, 0.0, 0.0, x * around, 0.0, theta * around)
        self._pose: Symmetric = START
        self._map: Symmetric = self._fresh
        self.degenerate = math.nan  # heading of the last scan's degenerate direction from the robot's [rad], or NaN

    def step(self, motion: StepMotion, tracked: Pose, fit: Fit | None) -> None:
        """Take in a scan and its fit; None if it was not used for the pose."""
        x, theta = self._a_metre * motion.distance, self._a_radian * motion.rotation
        if not motion.measured:
            x += self._config.extrapolated_translation**2
            theta += self._config.extrapolated_rotation**2
        self._pose = plus_diagonal(moved(self._pose, tracked), x, x, theta)
        self._map = plus_diagonal(moved(self._map, tracked), x, x, theta)
        self.degenerate = math.nan
        if fit is not None:
            self._register(fit)

    def mapped(self) -> None:
        """The scan went into the map: what is around the robot was made on the path that led here."""
        self._map = self._fresh

    @property
    def value(self) -> Symmetric:
        """The covariance at the last scan.

        Where the scans carry no information it is bounded by the error of the path on which the map was made.
        """
        floor, turn = FLOOR
        return plus_diagonal(inverse(plus(inverse(self._pose), inverse(self._map))), floor, floor, turn)

    def _register(self, fit: Fit) -> None:
        """The error after registration: A e + (1 - A) r, with A the prior's share, e the error before, r the scan's.

        With information I of the scan and P of the prior, A = H P, where H = (I + P)^-1; and r has the covariance
        s I^-1, with s from the residuals of this scan. C before, it is A C A^T + s H I H = H (P C P - s P) H + s H.
        """
        information = fit.information
        weight = self._config.prior_weight
        p, q, r = (weight / max(spread, 1e-9) ** 2 for spread in fit.spread)
        scale = residual_variance(fit.likelihood, self._config) * CORRELATION
        h = inverse(plus_diagonal(information, p, q, r))
        xx, xy, xt, yy, yt, tt = self._pose
        inner = (p * (p * xx - scale), p * q * xy, p * r * xt, q * (q * yy - scale), q * r * yt, r * (r * tt - scale))
        self._pose = plus(sandwiched(h, inner), h, scale)
        self.degenerate = self._least(information, scale)

    def _least(self, information: Symmetric, scale: float) -> float:
        """The heading of the direction about which a scan carries less information than the odometry; NaN without."""
        xx, xy, xt, yy, yt, tt = information
        tt = max(tt, 1e-9)
        # of the position alone, whatever the heading
        xx, xy, yy = xx - xt * xt / tt, xy - xt * yt / tt, yy - yt * yt / tt
        least = (xx + yy) / 2 - math.hypot((xx - yy) / 2, xy)
        if least * self._fresh[0] > scale:
            return math.nan
        across = math.atan2(2 * xy, xx - yy) / 2
        return across + math.pi / 2 if across <= 0 else across - math.pi / 2
