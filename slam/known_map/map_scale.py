"""Whether a map is as large as the odometry says, and as large in all directions."""

from __future__ import annotations

from collections import deque

import numpy as np

from moteslam.robot.se2 import Array, Pose, compose_one
from moteslam.robot.values import Issue

SEGMENT, SEGMENTS = 1.0, 8
"""Distances in the map and by the odometry are compared over this way [m], and up to as many times it."""
LEAST = 5.0  # Driven along an axis, at least, in SEGMENT [m]
STRETCHED, SCALED = 0.025, 0.04
"""Two directions that differ by so much in scale are a map's fault; from odometry any map differs by less than the
second: wheels wear, ``findings.SCALE``."""
SIGMAS = 4.0
"""Standard deviations that a difference must have, too: ways overlap, and wheels without a gyro turn poorly."""
ALONG = 15.0  # A direction within as much of an axis is called that [degrees]


class MapScale:
    """The distances that a robot goes that is sure of its pose, in the map and by its odometry.

    The map's are longer by a symmetric strain of the plane, of which a stretch and a skew are cases: by its product
    with the squares and twice the product of the direction's components. It needs no headings, which a skewed map
    bends.
    """

    def __init__(self) -> None:
        self._odometry: Pose = (0.0, 0.0, 0.0)
        self._places: deque[tuple[Array, Array]] = deque(maxlen=SEGMENTS)  # latest in the map and by odometry [m]
        self._normal, self._right, self._square, self._count = np.zeros((3, 3)), np.zeros(3), 0.0, 0

    def add(self, pose: Array, motion: Pose, *, known: bool) -> None:
        """A step that led to a pose [3] in the map; ``known`` if that is sure and the odometry measured the step."""
        if not known:
            self._places.clear()
            return
        self._odometry = compose_one(self._odometry, motion)
        place, driven = pose[:2].copy(), np.array(self._odometry[:2])
        if self._places and np.hypot(*(driven - self._places[-1][1])) < SEGMENT:
            return
        for there, then in self._places:
            length, mapped = float(np.hypot(*(driven - then))), place - there
            distance = float(np.hypot(*mapped))
            if min(length, distance) > SEGMENT / 2:
                cos, sin = mapped / distance
                row, more = length * np.array((cos * cos, sin * sin, 2 * cos * sin)), distance - length
                self._normal += np.outer(row, row)
                self._right += more * row
                self._square, self._count = self._square + more * more, self._count + 1
        self._places.append((place, driven))

    def issue(self) -> Issue | None:
        """What is wrong with the map's scale, if it is certain."""
        inverse = np.linalg.inv(self._normal + 1e-9 * np.eye(3))
        strain = inverse @ self._right
        left = max(float(self._square - strain @ self._right), 0.0)  # below 0 by rounding where the fit is exact
        variance = left / max(self._count, 1) * SEGMENTS / 2  # each way is in several
        along = self._normal[[0, 1], [0, 1]] > LEAST * SEGMENT
        stretch, skew = (strain[0] - strain[1]) / 2, strain[2]
        apart, turned = 2 * float(np.hypot(stretch, skew)), float(np.degrees(np.arctan2(skew, stretch)) / 2)
        of = np.array((stretch, -stretch, 2 * skew)) / max(apart / 2, 1e-9)
        if along.all() and apart > max(STRETCHED, SIGMAS * float(np.sqrt(variance * (of @ inverse @ of)))):
            text = (
                f"the map is {100 * apart:.1f} % longer along {turned:.0f} degrees to its x than across: skewed or bent"
            )
            if min(abs(turned), 90 - abs(turned)) < ALONG:
                longer = "longer" if abs(turned) < 45 else "shorter"
                text = f"the map is {100 * apart:.1f} % {longer} along x than along y: stretched"
            return Issue("map-scale", f"{text}, by distances of the odometry, and poses in it with it")
        bar = np.maximum(SCALED, SIGMAS * np.sqrt(variance * inverse.diagonal()[:2]))
        off = np.where(along, np.abs(strain[:2]) - bar, -1.0)
        if not (off > 0).any():
            return None
        percent = 100 * float(strain[off.argmax()])
        text = f"ways in the map are {abs(percent):.1f} % {'longer' if percent > 0 else 'shorter'} than by the "
        text += "odometry: the map's resolution, or the odometry's unit of length, is not as stated"
        return Issue("map-scale", text)
