"""Tracking between updates: a scan is registered to the best particle's map, and its motion holds for all particles.

The maps of two particles differ by bends that are long against the motion since the last update.
"""

import math
from typing import NamedTuple

import numpy as np

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot.se2 import Array, Pose, between_one, compose_one
from moteslam.slam.odometry.calibration import CalibrationConfig, OdometryCalibration, aside
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.localisation import Localiser, Rivals
from moteslam.slam.registration.registrar import Spread, prior_deviations
from moteslam.slam.tsdf.doubt import ScanFit
from moteslam.slam.tsdf.motion import CLOSED, STILL, MotionSinceUpdate, Open, StepMotion, Travelled, magnitude
from moteslam.slam.tsdf.motion import step_motion as as_step
from moteslam.slam.tsdf.particles import Particles
from moteslam.slam.tsdf.pose_covariance import Fit

NO_RIVALS = Rivals()
LARGEST_SPREAD = 2.0
"""Of a predicted position [m], however far no scan was registered: a search looks three times as far, in about a
second."""
CARRIED_DISTANCE, CARRIED_ROTATION, CARRIED_TIME = 0.5, 0.5, 3.0
"""A robot that is found this much farther off than it drove was carried [m], [rad]: a push is less; if it was not seen
for so long [s]: to lift it and to set it down takes that, else the odometry has failed."""


class Tracked(NamedTuple):
    motion: Pose  # since the scan before, in the frame of the pose there
    slipped: bool  # the odometry was off by more than it usually is
    lost: bool  # the scan contradicts the map: it is left out
    fit: Fit | None  # how it was registered; None if it has too few points
    rivals: Rivals  # where else the robot may be, from the tracked pose
    # how far off the pose is at most, where after a lapse of the odometry the scan does not say where in the map
    # the robot is [m]; 0 of all others.
    astray: float = 0.0
    carried: bool = False  # the scan was found farther off than the robot can have driven
    unseen: bool = False  # nothing was seen for long, and no wheels say where to the robot drove: it may be elsewhere


class Tracker:
    """Follows the robot from scan to scan in one particle's map."""

    def __init__(
        self, config: TrackingConfig, registration: RegistrationConfig, calibration: CalibrationConfig
    ) -> None:
        self._config, self._registration = config, registration
        self._calibration = OdometryCalibration(calibration)
        self._localiser = Localiser(config, registration)
        self.pose = STILL  # at the last scan, in the best particle's map
        self._motion, self._seconds = STILL, 0.0  # of the last step, as tracked, and how long it took
        self._slip = STILL  # how far the odometry was off in the last step, if it slipped
        self._blind, self._blind_measured = Travelled(), True  # since the last scan that was registered
        self._open = CLOSED  # of the motion since then
        self._seen = False  # whether a scan was registered at all
        self._lost = 0  # scans in a row that contradict the map

    def predict(self, motion: Pose, dt: float, *, measured: bool, left: Open | None = None) -> StepMotion:
        """The motion of a step of ``dt`` [s] by the calibrated odometry; at a constant velocity where none measured it.

        ``left``: open by a motion that was not measured, but of which more is known than the velocity before.
        """
        if measured or left is not None:
            left = CLOSED if measured or left is None else left
            return as_step(motion, self._calibration.corrected(motion), dt, measured=measured, left=left)
        constant = self._extrapolated(dt)
        return as_step(constant, constant, dt, measured=False)

    def calibrate(self, since: MotionSinceUpdate, offset: Pose, information: Array) -> None:
        """Update the odometry's gains with the motion since the last update.

        The offset is from where that leads to where the best particle's scan fits, the information [3, 3] of its
        endpoints.
        """
        if since.calibrates:
            self._calibration.update(since.wheels, compose_one(since.odometry, offset), information)

    def _extrapolated(self, dt: float) -> Pose:
        """The motion of a step of ``dt`` [s] at the velocity of the last one."""
        return extrapolated(self._motion, self._seconds, dt, most=self._config.max_extrapolation)

    def _spread(self) -> Spread:
        """Standard deviation of the prediction, over the distance since the last scan that was registered.

        What errors of the heading move the position aside counts in any direction, since the robot may have turned;
        where it is less than a basin of the registration the error of a step covers it.
        """
        driven = self._blind
        forward, left, turn = prior_deviations(
            self._registration, driven.distance, driven.rotation, measured=self._blind_measured
        )
        moved = aside(driven.distance, turn)
        if moved > self._config.basin_distance:
            forward, left = math.hypot(forward, moved), math.hypot(left, moved)
        place, heading, _ = self._open
        most = max(LARGEST_SPREAD, place)
        return min(math.hypot(forward, place), most), min(math.hypot(left, place), most), math.hypot(turn, heading)

    def _beyond(self, offset: Pose, deviations: Spread) -> Pose:
        """How far the odometry was off, forward, left [m] and in turn [rad]; 0 within ``slip_threshold`` deviations."""
        (shift, turn), (along, across, about), k = magnitude(offset), deviations, self._config.slip_threshold
        return (
            shift if shift > k * along else 0.0,
            shift if shift > k * across else 0.0,
            turn if turn > k * about else 0.0,
        )

    def _carried(self, offset: Pose) -> tuple[bool, bool]:
        """Whether an offset is larger than what slipping wheels can have missed: somebody moved the robot; and whether,
        wherever the scan was found, somebody may have: nothing was seen, and the wheels do not say that it drove.
        """
        driven, (shift, turn) = self._blind, magnitude(offset)
        unseen, known = driven.elapsed > CARRIED_TIME, self._blind_measured and self._open == CLOSED
        far = shift > driven.distance + CARRIED_DISTANCE or turn > driven.rotation + CARRIED_ROTATION
        drove = driven.distance > CARRIED_DISTANCE or driven.rotation > CARRIED_ROTATION
        return unseen and known and far, unseen and not (known and drove)

    def track(
        self, motion: StepMotion, scan: ThinnedScan, origin: tuple[float, float], particles: Particles
    ) -> Tracked:
        """Register a scan, whose rays start at ``origin`` [m], to the best particle's map."""
        predicted = compose_one(self.pose, motion.corrected)
        self._blind = self._blind.plus(motion.distance, motion.rotation, motion.dt)
        self._blind_measured &= motion.measured
        self._open = self._open.plus(motion.open)
        usual = self._spread()
        (forward, left, turn), (slip_forward, slip_left, slip_turn) = usual, self._slip
        spread = forward + slip_forward, left + slip_left, turn + slip_turn
        offset, fit, rivals, astray, carried, unseen = STILL, None, NO_RIVALS, 0.0, False, False
        if len(scan.points) >= self._config.min_points:

            def predictions() -> Array:
                if 0 < self._config.max_extrapolation * self._seconds < motion.dt:
                    return np.array((STILL,))
                return np.array((STILL, between_one(motion.corrected, self._extrapolated(motion.dt))))

            seen = particles.maps.of(particles.best), predicted, spread, scan.points, origin, predictions
            blind = self._blind.elapsed if self._seen else math.inf
            fitted, score, elsewhere, decided = self._localiser.locate(
                *seen, measured=self._blind_measured, left=self._open, slip=self._slip, blind=blind
            )
            share = score / max(fitted.known, 1.0)
            of_scan = ScanFit(share, len(scan.points), fitted.known, fitted.far, fitted.crossed)
            fit = Fit(fitted.information, fitted.likelihood, spread, of_scan)
            contradicts = self._localiser.contradicts(score, len(scan.points))
            if not decided:
                astray = self._config.window * self._open.place + magnitude(fitted.offset)[0]
            if decided and contradicts and self._lost < self._config.max_lost_scans:
                self._lost += 1
            else:
                offset, self._lost, self._seen = fitted.offset, 0, True
                carried, unseen = self._carried(offset)
                self._blind, self._blind_measured, self._open = Travelled(), True, CLOSED
                rivals = elsewhere
        self._slip = self._beyond(offset, usual)
        # this step alone decides whether its odometry is to be used: what was off may lie in the blind ones before
        forward, left, turn = prior_deviations(
            self._registration, motion.distance, motion.rotation, measured=motion.measured
        )
        place, heading, _ = motion.open
        of_step = math.hypot(forward, place), math.hypot(left, place), math.hypot(turn, heading)
        slipped = any(self._beyond(offset, of_step))
        moved = compose_one(predicted, offset)
        self._motion, self._seconds = between_one(self.pose, moved), motion.dt
        self.pose = moved
        return Tracked(self._motion, slipped, self._lost > 0, fit, rivals, astray, carried, unseen)


def extrapolated(motion: Pose, seconds: float, dt: float, *, most: float = 10.0) -> Pose:
    """The motion of a step of ``dt`` [s] at the velocity of the step before, of so many seconds.

    It is scaled by the ratio of the times where both are above 0, else the same, as in logs whose scans share stamps;
    to at most ``most`` times as long: a longer gap is likelier a wrong stamp, or a robot that has long stopped.
    """
    if seconds <= 0 or dt <= 0:
        return motion
    share = min(dt / seconds, most)
    x, y, turn = motion
    return x * share, y * share, turn * share
