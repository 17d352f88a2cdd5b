"""Recordings with a fault put in: wheels that stop counting, odometry that jumps, scans that see nothing."""

from dataclasses import replace

import numpy as np

from moteslam.robot import se2
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.slam.odometry.dead_reckoning import dead_reckon


def between(recording: Recording, stamps: np.ndarray, begin: float, end: float) -> np.ndarray:
    """Which stamps lie so long after the first scan [s]."""
    since = stamps - recording.lidar.stamps[0]
    return (since >= begin) & (since < end)


def stopped_wheels(recording: Recording, begin: float, end: float) -> Recording:
    """The encoders count nothing from ``begin`` to ``end``, seconds after the first scan; the gyro goes on."""
    encoders = recording.encoders
    stopped = between(recording, encoders.stamps, begin, end)
    return recording.replace(encoders=replace(encoders, counts=np.where(stopped[:, None], 0, encoders.counts)))


def jumping_odometry(recording: Recording, at: float, jump: np.ndarray, *, back: float | None = None) -> Recording:
    """The odometry as logged poses that jump by [3], in the robot's frame, at a time; and back again at another."""
    path = dead_reckon(recording)
    increments = np.vstack((np.zeros(3), se2.between(path.poses[:-1], path.poses[1:])))
    since = path.stamps - path.stamps[0]
    for when, by in ((at, jump), (back, se2.inverse(jump))):
        if when is not None:
            first = int(np.searchsorted(since, when))
            increments[first] = se2.compose(increments[first], by)
    odometry = OdometryStream(path.stamps, se2.accumulate(increments))
    return recording.replace(encoders=None, imu=None, odometry=odometry)


def blind(recording: Recording, begin: float, end: float) -> Recording:
    """The lidar sees nothing from ``begin`` to ``end``, seconds after the first scan."""
    lidar = recording.lidar
    dark = between(recording, lidar.stamps, begin, end)
    return recording.replace(lidar=replace(lidar, ranges=np.where(dark[:, None], np.float32(np.inf), lidar.ranges)))


def without_odometry(recording: Recording) -> Recording:
    """Scans alone."""
    return recording.replace(encoders=None, imu=None, odometry=None)
