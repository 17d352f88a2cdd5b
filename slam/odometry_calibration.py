"""What a robot's odometry is systematically off by, learned from its scans while it drives.

Wheels are not as large, nor as far apart, as their driver believes, carpets drag to a side, and the lidar is not where
the log says: recorded odometry is off by some percent, always the same way. What is always the same can be known
(Censi, Franchi, Marchionni and Oriolo 2013, Simultaneous calibration of odometry and sensor parameters).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.surface_config import CalibrationConfig

Array = NDArray[np.float64]


class OdometryCalibration:
    """Learns how long a way really is, how far a turn goes, how much a straight way bends, and where the lidar is.

    Args:
        config: what is assumed before anything is known.
    """

    def __init__(self, config: CalibrationConfig) -> None:
        self._config = config
        self._way = _Gains([1.0], [config.scale], config.change)
        self._turn = _Gains([1.0, 0.0], [config.scale, config.curvature], config.change)
        self._lever = _Gains([0.0], [config.lever], config.change)

    @property
    def scale(self) -> float:
        """The true way over that of the odometry."""
        return self._way.values[0]

    @property
    def turn_gain(self) -> float:
        """The true turn over that of the odometry."""
        return self._turn.values[0]

    @property
    def curvature(self) -> float:
        """What a way that is straight by the odometry turns by [rad/m]."""
        return self._turn.values[1]

    @property
    def lever(self) -> float:
        """How far the lidar is ahead of where it is said to be, seen from the wheels' axle [m]."""
        return self._lever.values[0]

    def corrected(self, motion: Array) -> Array:
        """An increment of the odometry [3] as it is likely to have been."""
        x, y, turn = self._on_axle(motion)
        return np.array([x + self.lever * (math.cos(turn) - 1), y + self.lever * math.sin(turn), turn])

    def learn(self, odometry: Array, found: Array, information: Array) -> None:
        """Take in what a motion was.

        Args:
            odometry: [3] as the wheels told it, not corrected.
            found: [3] as the scans tell it.
            information: [3, 3] of the scan's endpoints about its pose.
        """
        if not self._config.enabled:
            return
        c = self._config
        x, _, turn = odometry.tolist()
        off = (found - self.corrected(odometry)).tolist()
        swing = math.sin(found[2])
        about_x, about_y, about_turn = (1 / max(value, 1e-9) for value in information.diagonal().tolist())
        of_way = (c.translation + c.translation_from_translation * abs(x)) ** 2
        of_turn = (c.rotation + c.rotation_from_rotation * abs(turn)) ** 2
        for gains, row, error, variance in (
            (self._way, [x], off[0], of_way + about_x),
            (self._lever, [swing], off[1], of_way + about_y),
            (self._turn, [turn, x], off[2], of_turn + about_turn),
        ):
            gains.change_over(abs(x))
            gains.learn(row, error, variance, c.gate)

    def _on_axle(self, motion: Array) -> tuple[float, float, float]:
        """The same motion of the axle: its way rescaled and bent along the half of the turn that is added."""
        x, y, turn = motion.tolist()
        bend = self.turn_gain * turn + self.curvature * x - turn
        cos, sin = self.scale * math.cos(bend / 2), self.scale * math.sin(bend / 2)
        return cos * x - sin * y, sin * x + cos * y, turn + bend


class _Gains:
    """Constants that a Kalman filter learns, and that change a little with the way.

    Args:
        values: [k] before anything is known, and
        deviations: [k] the standard deviations of that.
        change: standard deviation of their change over a metre, of a gain with ``deviations[0]``.
    """

    def __init__(self, values: list[float], deviations: list[float], change: float) -> None:
        self.values = values
        self._most = [deviation**2 for deviation in deviations]
        # rows of plain numbers: for one gain or two, arrays take ten times as long
        self._covariance: list[list[float]] = np.diag(self._most).tolist()
        self._change = [change**2 * most / self._most[0] for most in self._most]

    def change_over(self, way: float) -> None:
        """Over so many metres they may have changed; never are they less known than before anything was."""
        for i, (line, most, change) in enumerate(zip(self._covariance, self._most, self._change, strict=True)):
            line[i] += min(change * way, max(most - line[i], 0.0))

    def learn(self, row: list[float], error: float, variance: float, gate: float) -> None:
        """How far what is ``row`` times the gains was off; nothing beyond so many standard deviations."""
        pulls = [sum(c * r for c, r in zip(line, row, strict=True)) for line in self._covariance]
        total = sum(r * pull for r, pull in zip(row, pulls, strict=True)) + variance
        if error * error >= gate**2 * total:
            return
        weights = [pull / total for pull in pulls]
        self.values = [value + weight * error for value, weight in zip(self.values, weights, strict=True)]
        self._covariance = [
            [c - weight * pull for c, pull in zip(line, pulls, strict=True)]
            for line, weight in zip(self._covariance, weights, strict=True)
        ]
