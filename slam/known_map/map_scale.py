"""Whether a map is as large as the odometry says, and as large along x as along y."""

from __future__ import annotations

import numpy as np

from moteslam.robot.se2 import Array, Pose, as_pose, compose_one
from moteslam.robot.values import Issue

SEGMENT = 1.0
"""Motions in the map and by the odometry are compared over so much of a way [m]."""
LEAST = 5.0
"""Driven along an axis, at least [m]."""
STRETCHED, SCALED = 0.025, 0.04
"""Two axes that differ by so much in scale are a map's fault; from odometry any map differs by less than the second:
wheels wear, ``findings.SCALE``."""
SIGMAS = 2.0
"""Standard deviations that a difference must have, too."""


class MapScale:
    """The motion of a robot that is sure of its pose, in the map and by its odometry."""

    def __init__(self) -> None:
        self._from: Array | None = None  # the pose where the segment began
        self._odometry: Pose = (0.0, 0.0, 0.0)  # since then
        self._segments: list[tuple[Array, Array]] = []  # in the map, by the odometry [m]

    def add(self, pose: Array, motion: Pose, *, known: bool) -> None:
        """A step that led to a pose [3] in the map; ``known`` if that is sure and the odometry measured the step."""
        if not known or self._from is None:
            self._from, self._odometry = (pose if known else None), (0.0, 0.0, 0.0)
            return
        self._odometry = compose_one(self._odometry, motion)
        if np.hypot(*self._odometry[:2]) < SEGMENT:
            return
        began = as_pose(self._from)
        expected = np.array(compose_one(began, self._odometry))
        self._segments.append((pose[:2] - self._from[:2], expected[:2] - self._from[:2]))
        self._from, self._odometry = pose, (0.0, 0.0, 0.0)

    def issue(self) -> Issue | None:
        """What is wrong with the map's scale, if it is certain."""
        if not self._segments:
            return None
        mapped, driven = (np.array(each) for each in zip(*self._segments, strict=True))
        square = np.maximum(np.square(driven).sum(axis=0), 1e-9)
        scale = (mapped * driven).sum(axis=0) / square
        deviation = np.sqrt(np.square(mapped - scale * driven).mean(axis=0) / square)
        measured = square > LEAST * SEGMENT
        if measured.all() and abs(np.subtract(*scale)) > max(STRETCHED, SIGMAS * float(np.hypot(*deviation))):
            percent = 100 * (scale[0] / scale[1] - 1)
            text = f"the map is {abs(percent):.1f} % {'longer' if percent > 0 else 'shorter'} along x than along y, by "
            text += f"{len(driven)} m of odometry: it was stretched, and poses in it with it"
            return Issue("map-scale", text)
        off = np.where(measured, np.abs(scale - 1) - np.maximum(SCALED, SIGMAS * deviation), -1.0)
        if not (off > 0).any():
            return None
        percent = 100 * (float(scale[off.argmax()]) - 1)
        text = f"ways in the map are {abs(percent):.1f} % {'longer' if percent > 0 else 'shorter'} than by the "
        text += "odometry: the map's resolution, or the odometry's unit of length, is not as stated"
        return Issue("map-scale", text)
