"""A robot that is carried off: it stands in another place when it looks again, and its odometry knows nothing of it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.robot.trajectory import Trajectory


def carried_off(recording: Recording, truth: Trajectory, *, after: float, distance: float) -> Recording:
    """The recording without the scans of a part of its path, on which the odometry stands still.

    Args:
        recording: with the odometry's pose at every scan.
        truth: of it.
        after: the part begins after this share of the path.
        distance: its length along the path [m].
    """
    from moteslam.robot import se2

    lidar = recording.lidar
    assert lidar is not None
    assert lidar.odometry is not None
    poses = truth.at(lidar.stamps).poses
    path = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    first = int(np.searchsorted(path, after * path[-1]))
    last = int(np.searchsorted(path, path[first] + distance))
    kept = np.r_[0:first, last : len(path)]
    steps = np.vstack((lidar.odometry[:1], se2.between(lidar.odometry[:-1], lidar.odometry[1:])))[kept]
    steps[first] = 0.0
    seen = replace(lidar, stamps=lidar.stamps[kept], ranges=lidar.ranges[kept], odometry=se2.accumulate(steps))
    return recording.replace(lidar=seen, encoders=None, imu=None, odometry=None)
