"""Pure pursuit: a driver that follows a path."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from moteslam.sim.robot.limits import Limits

SPACING = 0.05
"""Between the points that a path is sampled at [m]."""


class PathDriver:
    """Pure pursuit (Coulter 1992): aim at the point of the path a look-ahead distance on; see `Driver`.

    Slows down before the end, and in bends to the speed that its turn rate allows; turns nearly on the spot to a point
    well to the side or behind. A smooth sideways error, drawn from ``rng``, keeps it from driving like a tram.

    Args:
        path: corners [k, 2] [m].
        limits: to drive within.
        rng: of the sideways error.
    """

    looks = True

    def __init__(self, path: NDArray[np.float64], limits: Limits, rng: np.random.Generator) -> None:
        points, length = sampled(path)
        points = points + _sway(points, length, limits, rng)
        self.path = points
        self._x, self._y = points.T.tolist()
        self._limits = limits
        self.at = 0
        self._ahead = max(1, round(limits.lookahead / SPACING))

    def command(self, time: float, x: float, y: float, theta: float) -> tuple[float, float] | None:
        """See `Driver`; arrived when the nearest point ahead is the last, or the last is hardly reachable."""
        limits, last = self._limits, len(self._x) - 1
        self.at = min(
            range(self.at, min(self.at + 2 * self._ahead, last) + 1),
            key=lambda i: (self._x[i] - x) ** 2 + (self._y[i] - y) ** 2,
        )
        left = (last - self.at) * SPACING
        target = min(self.at + self._ahead, last)
        dx, dy = self._x[target] - x, self._y[target] - y
        distance = math.hypot(dx, dy)
        bearing = math.remainder(math.atan2(dy, dx) - theta, math.tau)
        if left < SPACING or (target == last and distance < 0.3 and abs(bearing) > 1.5):
            return None
        stopping = math.sqrt(2 * limits.acceleration * 0.7 * max(distance if target == last else left, 0.0)) + 0.02
        if abs(bearing) > 1.2:
            return 0.05, math.copysign(limits.turn_rate, bearing)
        curvature = 2 * math.sin(bearing) / max(distance, 0.2)
        speed = min(limits.speed, stopping, limits.speed * math.cos(bearing) ** 2)
        speed = min(speed, limits.turn_rate / max(abs(curvature), 1e-9))
        return speed, speed * curvature

    @property
    def done(self) -> float:
        """See `Driver`."""
        return self.at / (len(self._x) - 1)


def sampled(path: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The path at every ``SPACING`` of its length, its end included: points [n, 2], length up to each [n] [m]."""
    corners = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    length = np.linspace(0.0, corners[-1], max(2, round(corners[-1] / SPACING) + 1))
    return np.stack([np.interp(length, corners, path[:, axis]) for axis in (0, 1)], axis=-1), length


def _sway(
    points: NDArray[np.float64], length: NDArray[np.float64], limits: Limits, rng: np.random.Generator
) -> NDArray[np.float64]:
    """A smooth sideways error [n, 2] [m], none at the first point."""
    knots = np.arange(0.0, length[-1] + 2 * limits.wander_distance, limits.wander_distance)
    error = limits.wander * rng.standard_normal(len(knots))
    error[0] = 0.0
    # half-cosine between the knots: smooth, and never beyond them
    share = length / limits.wander_distance
    i = np.minimum(share.astype(int), len(knots) - 2)
    blend = (1 - np.cos(np.pi * (share - i))) / 2
    sideways = error[i] * (1 - blend) + error[i + 1] * blend
    heading = np.gradient(points, axis=0)
    heading /= np.maximum(np.hypot(*heading.T)[:, None], 1e-12)
    left = np.stack((-heading[:, 1], heading[:, 0]), axis=-1)
    return np.asarray(left * sideways[:, None], np.float64)
