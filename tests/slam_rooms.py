"""Recordings of a robot in a room small enough to reason about, for tests of the filters."""

from __future__ import annotations

import numpy as np

from moteslam.robot import se2
from moteslam.robot.platforms import CARMEN
from moteslam.robot.recording import LidarStream, Recording


def circled_room(*, scans: int = 120, drift: float = 0.03) -> tuple[Recording, np.ndarray]:
    """A robot that circles in a 6 x 4 m room with a box in it; its odometry drifts. Returns the true poses too."""
    turn = 2 * np.pi / 60
    true = se2.accumulate(np.vstack(([0, 0, 0], np.tile([0.08, 0, turn], (scans - 1, 1)))))
    odometry = se2.accumulate(np.vstack(([0, 0, 0], np.tile([0.08, 0, turn * (1 + drift)], (scans - 1, 1)))))
    angles = np.radians(np.arange(-135, 135, 1.5))
    walls = [((-3, -1.5), (3, -1.5)), ((3, -1.5), (3, 2.5)), ((3, 2.5), (-3, 2.5)), ((-3, 2.5), (-3, -1.5))]
    walls += [((1.5, -0.8), (2.2, -0.8)), ((1.5, -0.8), (1.5, -0.2))]
    ranges = np.full((scans, len(angles)), np.inf)
    for a, b in np.array(walls, float):
        for scan, (x, y, theta) in enumerate(true):
            direction = np.stack((np.cos(angles + theta), np.sin(angles + theta)))
            edge, offset = b - a, a - (x, y)
            cross = direction[0] * edge[1] - direction[1] * edge[0]
            with np.errstate(divide="ignore", invalid="ignore"):  # beams along a wall
                t = (offset[0] * edge[1] - offset[1] * edge[0]) / cross
                u = (offset[0] * direction[1] - offset[1] * direction[0]) / cross
            hit = (t > 0) & (u >= 0) & (u <= 1)
            ranges[scan] = np.where(hit, np.minimum(ranges[scan], t), ranges[scan])
    lidar = LidarStream(
        np.arange(scans) * 0.1, ranges.astype(np.float32), angles[0], np.radians(1.5), 0.1, 30.0, odometry=odometry
    )
    return Recording("room", CARMEN, lidar=lidar), true
