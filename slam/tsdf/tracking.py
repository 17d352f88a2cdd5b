"""Tracking between updates: a scan is registered to the best particle's map, and its motion holds for all particles.

The maps of two particles differ by bends that are long against the motion since the last update.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.thinning import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.odometry.calibration import OdometryCalibration
from moteslam.slam.odometry.config import CalibrationConfig
from moteslam.slam.odometry.constant_velocity import extrapolated
from moteslam.slam.odometry.noise import aside
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.localisation import Localiser, Rivals
from moteslam.slam.registration.registrar import prior_spread
from moteslam.slam.tsdf.motion import MotionSinceUpdate, StepMotion, Travelled, magnitude
from moteslam.slam.tsdf.particles import Particles
from moteslam.slam.tsdf.pose_covariance import Fit

Array = NDArray[np.float64]

LARGEST_SPREAD = 2.0
"""Of a predicted position [m], however far no scan was registered: a search looks three times as far, in about a
second."""


class Tracked(NamedTuple):
    """A step as tracked.

    Attributes:
        motion: [3] since the scan before, in the frame of the pose there.
        slipped: the odometry was off by more than it usually is.
        lost: the scan contradicts the map: it is left out.
        fit: how it was registered; None where it was not, since it has too few points.
        rivals: where else the robot may be, from the tracked pose.
    """

    motion: Array
    slipped: bool
    lost: bool
    fit: Fit | None
    rivals: Rivals


class Tracker:
    """Follows the robot from scan to scan in one particle's map.

    Args:
        config: of search, relocation and slips.
        registration: of each registration.
        calibration: of the odometry.

    Attributes:
        pose: [3] at the last scan, in the best particle's map.
    """

    def __init__(
        self, config: TrackingConfig, registration: RegistrationConfig, calibration: CalibrationConfig
    ) -> None:
        self._config, self._registration = config, registration
        self._calibration = OdometryCalibration(calibration)
        self._localiser = Localiser(config, registration)
        self.pose = np.zeros(3)
        self._motion, self._seconds = np.zeros(3), 0.0  # of the last step, as tracked, and how long it took
        self._slip = np.zeros(3)  # how far the odometry was off in the last step, if it slipped
        self._blind, self._blind_measured = Travelled(), True  # since the last scan that was registered
        self._lost = 0  # scans in a row that contradict the map

    def predict(self, motion: Array, dt: float, *, measured: bool) -> StepMotion:
        """The motion of a step by the calibrated odometry; at a constant velocity where nothing measured it.

        Args:
            motion: [3] by the odometry.
            dt: of the step [s].
            measured: whether the odometry measured it.
        """
        if measured:
            return StepMotion(motion, self._calibration.corrected(motion), dt, measured)
        constant = self._extrapolated(dt)
        return StepMotion(constant, constant, dt, measured)

    def calibrate(self, since: MotionSinceUpdate, offset: Array, information: Array) -> None:
        """Update the odometry's gains with the motion since the last update.

        Args:
            since: that motion.
            offset: [3] from where it leads to where the best particle's scan fits.
            information: [3, 3] of that scan's endpoints.
        """
        if since.calibrates:
            self._calibration.update(since.wheels, se2.compose(since.odometry, offset), information)

    def _extrapolated(self, dt: float) -> Array:
        """The motion [3] of a step of ``dt`` [s] at the velocity of the last one."""
        return extrapolated(self._motion, self._seconds, dt, most=self._config.max_extrapolation)

    def _spread(self, motion: StepMotion) -> Array:
        """Standard deviation [3] of the prediction, over the distance since the last scan that was registered.

        What errors of the heading move the position aside counts in any direction, since the robot may have turned;
        where it is less than a basin of the registration the error of a step covers it.
        """
        driven, measured = self._blind.plus(motion.corrected, motion.dt), self._blind_measured and motion.measured
        spread = prior_spread(self._registration, driven.distance, driven.rotation, measured=measured)
        forward, left, turn = spread.tolist()
        moved = aside(driven.distance, turn)
        if moved > self._config.basin_distance:
            forward, left = math.hypot(forward, moved), math.hypot(left, moved)
        return np.array((min(forward, LARGEST_SPREAD), min(left, LARGEST_SPREAD), turn))

    def track(self, motion: StepMotion, scan: ThinnedScan, origin: Array, particles: Particles) -> Tracked:
        """Register a scan to the best particle's map.

        Args:
            motion: since the scan before, as predicted.
            scan: thinned, in the robot's frame.
            origin: [2] where its rays start.
            particles: whose best one is tracked.
        """
        predicted = se2.compose(self.pose, motion.corrected)
        usual = self._spread(motion)
        spread = usual + self._slip
        offset, fit, rivals = np.zeros(3), None, Rivals()
        self._blind = self._blind.plus(motion.corrected, motion.dt)
        self._blind_measured &= motion.measured
        if len(scan.points) >= self._config.min_points:

            def predictions() -> Array:
                return np.stack((np.zeros(3), se2.between(motion.corrected, self._extrapolated(motion.dt))))

            found, score, elsewhere = self._localiser.locate(
                particles.maps.of(particles.best), predicted, spread, scan.points, origin, predictions
            )
            share = score / max(float(found.known[0]), 1.0)
            fit = Fit(found.information[0], float(found.likelihoods[0]), spread, share)
            contradicts = self._localiser.contradicts(score, len(scan.points))
            if contradicts and self._lost < self._config.max_lost_scans:
                self._lost += 1
            else:
                offset, self._lost = found.offsets[0], 0
                self._blind, self._blind_measured = Travelled(), True
                rivals = elsewhere
        shift, turn = magnitude(offset)
        off, threshold = (shift, shift, turn), self._config.slip_threshold
        self._slip = np.array([o if o > threshold * u else 0.0 for o, u in zip(off, usual.tolist(), strict=True)])
        # this step alone decides whether its odometry is to be used: what was off may lie in the blind ones before
        step = prior_spread(self._registration, *magnitude(motion.corrected), measured=motion.measured)
        slipped = any(o > threshold * s for o, s in zip(off, step.tolist(), strict=True))
        moved = se2.compose(predicted, offset)
        self._motion, self._seconds = se2.between(self.pose, moved), motion.dt
        self.pose = moved
        return Tracked(self._motion, slipped, self._lost > 0, fit, rivals)
