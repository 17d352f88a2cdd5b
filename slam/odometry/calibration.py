"""Systematic errors of the odometry, estimated from the scans while driving.

Wheels are not as large, nor as far apart, as the platform states, carpets drag to a side, and the lidar is not where
the log puts it: recorded odometry is off by some percent, always in the same direction, so the error can be estimated
(Censi, Franchi, Marchionni and Oriolo 2013, Simultaneous calibration of odometry and sensor parameters).
"""

import math
from typing import TypeVar

import numpy as np

from moteslam.robot.se2 import Array, Pose
from moteslam.robot.values import NotNegative, Positive, Section, Truth

Lengths = TypeVar("Lengths", float, Array)


def aside(distance: Lengths, heading: Lengths) -> Lengths:
    """The standard deviation of a position to the side of a motion [m], by that of the heading at its end [rad].

    An error that grows evenly with the distance [m] turns the end about the beginning by a third of its variance.
    """
    return distance * heading / math.sqrt(3)


class CalibrationConfig(Section):
    """Calibration of the odometry while driving: four gains, each a small Kalman filter."""

    enabled: Truth = True  # Estimate the odometry's systematic errors and correct them
    scale: Positive = 0.05  # Prior standard deviation of the scale error of distances and of turns [m/m], [rad/rad]
    curvature: Positive = 0.02  # Prior deviation of the curvature of a path that is straight by the odometry [rad/m]
    lidar_offset: Positive = 0.1  # Prior deviation of the lidar's place ahead of the recorded one, from the axle [m]
    change: NotNegative = 0.001  # Standard deviation by which these gains change over a metre [1/sqrt(m)]
    translation: Positive = 0.005  # Standard deviation of the odometry's random error of one motion, at rest [m]
    translation_from_translation: NotNegative = 0.03  # Added to that for every metre [m/m]
    rotation: Positive = 0.01  # Standard deviation of the random error of its heading, at rest [rad]
    rotation_from_rotation: NotNegative = 0.1  # Added to that for every radian [rad/rad]
    gate: Positive = 3.0  # Validation gate: an innovation of more standard deviations is left out; wheels slipped


class OdometryCalibration:
    """Estimates the scale of distances and turns, the curvature of straight paths, and the lidar's offset."""

    def __init__(self, config: CalibrationConfig) -> None:
        self._config = config
        # the true distance over that of the odometry
        self.distance = _Gains([1.0], [config.scale], config.change)
        # the true turn over that of the odometry; the turn per distance of a path that is straight by it [rad/m]
        self.turn = _Gains([1.0, 0.0], [config.scale, config.curvature], config.change)
        # how far the lidar is ahead of where the recording says, seen from the wheels' axle [m]
        self.offset = _Gains([0.0], [config.lidar_offset], config.change)

    def corrected(self, motion: Pose) -> Pose:
        """An increment of the odometry with its systematic errors removed."""
        (x, y, turn), (scale,), (offset,) = motion, self.distance.values, self.offset.values
        turn_scale, curvature = self.turn.values
        # the axle's distance is rescaled, and bent along half of the turn that is added
        bend = turn_scale * turn + curvature * x - turn
        cos, sin, turn = scale * math.cos(bend / 2), scale * math.sin(bend / 2), turn + bend
        x, y = cos * x - sin * y, sin * x + cos * y
        return x + offset * (math.cos(turn) - 1), y + offset * math.sin(turn), turn

    def update(self, odometry: Pose, registered: Pose, information: Array) -> None:
        """Update the gains with one motion, and the information [3, 3] of the scan's endpoints about its pose."""
        if not self._config.enabled:
            return
        c = self._config
        x, _, turn = odometry
        innovation = [found - known for found, known in zip(registered, self.corrected(odometry), strict=True)]
        swing = math.sin(registered[2])
        about_x, about_y, about_turn = (1 / max(value, 1e-9) for value in information.diagonal().tolist())
        of_distance = (c.translation + c.translation_from_translation * abs(x)) ** 2
        of_turn = (c.rotation + c.rotation_from_rotation * abs(turn)) ** 2
        # Noise in the regressor dilutes a slope (errors in variables): in a straight corridor, where the odometry turns
        # by noise alone, to nothing. The turn by odometry and scan together is uncorrelated with the innovation
        noise = max(of_turn, innovation[2] ** 2 - about_turn)
        turned = (registered[2] - about_turn / (noise + about_turn) * innovation[2]) / self.turn.values[0]
        for gains, row, error, variance in (
            (self.distance, [x], innovation[0], of_distance + about_x),
            (self.offset, [swing], innovation[1], of_distance + about_y),
            (self.turn, [turned, x], innovation[2], of_turn + about_turn),
        ):
            gains.predict(abs(x))
            gains.update(row, error, variance, c.gate)


class _Gains:
    """A Kalman filter of constants [k], with prior deviations [k], that change a little with the distance driven.

    ``change`` is the standard deviation of their change over a metre, of a gain with ``deviations[0]``.
    """

    def __init__(self, values: list[float], deviations: list[float], change: float) -> None:
        self.values = values
        self._most = [deviation**2 for deviation in deviations]
        # rows of plain numbers: for one gain or two, arrays take ten times as long
        self._covariance: list[list[float]] = np.diag(self._most).tolist()
        self._change = [change**2 * most / self._most[0] for most in self._most]

    def predict(self, distance: float) -> None:
        """Add the process noise of a distance [m]; no variance grows beyond that of its prior."""
        for i, (line, most, change) in enumerate(zip(self._covariance, self._most, self._change, strict=True)):
            line[i] += min(change * distance, max(most - line[i], 0.0))

    def update(self, row: list[float], innovation: float, variance: float, gate: float) -> None:
        """One scalar measurement of ``row`` times the gains; left out beyond ``gate`` standard deviations."""
        pulls = [sum(c * r for c, r in zip(line, row, strict=True)) for line in self._covariance]
        total = sum(r * pull for r, pull in zip(row, pulls, strict=True)) + variance
        if innovation * innovation >= gate**2 * total:
            return
        weights = [pull / total for pull in pulls]
        self.values = [value + weight * innovation for value, weight in zip(self.values, weights, strict=True)]
        self._covariance = [
            [c - weight * pull for c, pull in zip(line, pulls, strict=True)]
            for line, weight in zip(self._covariance, weights, strict=True)
        ]
