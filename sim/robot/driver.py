"""Drivers: their limits, what they are asked, pure pursuit along a path, and how they mind who is ahead.

The driver of the real robot saw where it was, and so does a simulated one. SLAM is given the sensors' readings.
"""

from __future__ import annotations

import math
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.platform import Platform
from moteslam.robot.values import Number, Positive, Section

MAX_DURATION = 12_000.0
"""The longest recording [s], for two kilometres at 0.2 m/s; of `ucsd` 480 000 scans, 2.1 GB of ranges."""

Seconds = Annotated[Number, Field(ge=0, le=MAX_DURATION)]


class Limits(Section):
    """How the robot drives.

    Attributes:
        speed, turn_rate: at most [m/s, rad/s].
        acceleration, turn_acceleration: of these, at most [m/s^2, rad/s^2].
        lookahead: distance ahead on the route that is aimed at [m].
        wander: standard deviation of the driver's sideways inattention [m], over ``wander_distance`` [m].
        rest_start, rest_end: standing still before and after [s]: long enough to see the gyro's bias.
    """

    speed: Annotated[Number, Field(gt=0, le=3)] = 0.95
    turn_rate: Annotated[Number, Field(gt=0, le=3)] = 1.0
    acceleration: Annotated[Number, Field(gt=0, le=5)] = 0.8
    turn_acceleration: Annotated[Number, Field(gt=0, le=10)] = 2.5
    lookahead: Annotated[Number, Field(gt=0, le=5)] = 0.7
    wander: Annotated[Number, Field(ge=0, le=1)] = 0.03
    wander_distance: Positive = 2.0
    rest_start: Seconds = 6.0
    rest_end: Seconds = 4.0


class Driver(Protocol):
    """Chooses what to do next.

    Attributes:
        looks: whether it slows down for people and doors, and gives up where it does not get on.
        path: the points [n, 2] that it drives along [m]; None where it follows no path.
        at: the index of where it is on its path; set where it is to go on from another place.
    """

    looks: bool
    path: NDArray[np.float64] | None
    at: int

    def command(self, time: float, x: float, y: float, theta: float) -> tuple[float, float] | None:
        """The speed [m/s] and turn rate [rad/s] to ask for at a time [s since the rest ended] and true pose.

        None when the driver has arrived.
        """
        ...

    @property
    def done(self) -> float:
        """The share of the path or time that lies behind."""
        ...


SPACING = 0.05
"""Between the points that a path is sampled at [m]."""


class PathDriver:
    """Pure pursuit (Coulter 1992) of corners [k, 2] [m]: aim at the point of the path a look-ahead distance on.

    Slows down before the end, and in bends to the speed that its turn rate allows; turns nearly on the spot to a point
    well to the side or behind. A smooth sideways error, drawn from ``rng``, keeps it from driving like a tram.
    """

    looks = True

    def __init__(self, path: NDArray[np.float64], limits: Limits, rng: np.random.Generator) -> None:
        points, length = sampled(path)
        points = points + _sway(points, length, limits, rng)
        self.path: NDArray[np.float64] | None = points
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


STOP_GAP, SLOW_GAP = 0.25, 0.9
"""The robot stops with the first gap to who is ahead, and slows down over the second before that [m]."""
SIDE_GAP = 0.08
"""Who leaves less than this beside the robot is in its path [m]."""
PATIENCE = 60.0
"""How long a driver waits for its path to become free [s]."""


def pace(
    pose: tuple[float, float, float],
    platform: Platform,
    centres: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> float:
    """The share of its speed that the robot drives at among discs at ``centres`` [n, 2] of ``radii`` [n] [m]."""
    x, y, theta = pose
    away = centres - (x, y)
    cos, sin = math.cos(theta), math.sin(theta)
    ahead, left = away @ (cos, sin), away @ (-sin, cos)
    in_path = (ahead > 0) & (np.abs(left) < platform.width / 2 + radii + SIDE_GAP)
    if not in_path.any():
        return 1.0
    gap = float((ahead - radii)[in_path].min()) - platform.length / 2
    return min(max((gap - STOP_GAP) / SLOW_GAP, 0.0), 1.0)
