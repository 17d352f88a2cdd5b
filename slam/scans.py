"""The endpoints of any scan of a recording in the robot's frame, as if the scan had been taken at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.slam.config import SyncConfig
from moteslam.slam.synchronise import has_odometry, jumps, odometry_at_scans, odometry_path, require_lidar

Array = NDArray[np.float64]


class Scans:
    """Scans as points, de-skewed if the configuration says so and the recording knows how long a sweep takes.

    Args:
        recording: with a lidar.
        config: ``deskew`` turns every beam by how the robot moved since the first of its scan, by the odometry.
        max_range: endpoints beyond it are left out [m].

    Attributes:
        origin: [2] where the rays start, in the robot's frame [m].

    Raises:
        InputError: there is no lidar.
    """

    def __init__(self, recording: Recording, config: SyncConfig, *, max_range: float = np.inf) -> None:
        self._lidar = require_lidar(recording)
        self._max_range = max_range
        x, y, yaw = recording.platform.lidar.pose
        angles = self._lidar.angles + yaw
        self._directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        self.origin = np.array([x, y])
        self._sweeps = _sweeps(recording, config) if config.deskew else None

    def points(self, index: int) -> NDArray[np.float32]:
        """The finite endpoints [k, 2] of a scan [m], in the robot's frame at the scan's stamp."""
        ranges = self._lidar.ranges[index]
        good = np.isfinite(ranges) & (ranges <= self._max_range)
        points: Array = self.origin + ranges[good, None] * self._directions[good]
        if self._sweeps is not None:
            x, y, turn = self._sweeps[index]
            share = np.flatnonzero(good) / max(len(ranges) - 1, 1)
            cos, sin = np.cos(turn * share), np.sin(turn * share)
            points = np.stack(
                (
                    cos * points[:, 0] - sin * points[:, 1] + x * share,
                    sin * points[:, 0] + cos * points[:, 1] + y * share,
                ),
                axis=1,
            )
        return points.astype(np.float32)


def _sweeps(recording: Recording, config: SyncConfig) -> Array | None:
    """How the robot moves while each scan is taken, [n, 3] in its frame at the first beam; None where unknown."""
    lidar = require_lidar(recording)
    seconds = (lidar.time_increment or recording.platform.lidar.time_increment) * (lidar.ranges.shape[1] - 1)
    if seconds <= 0 or not has_odometry(recording):
        return None
    stamps, poses = odometry_path(recording, config)
    motion = se2.between(
        se2.interpolate(stamps, poses, lidar.stamps), se2.interpolate(stamps, poses, lidar.stamps + seconds)
    )
    # odometry that jumps before the next scan tells nothing of how the robot moved in this one
    motion[:-1][jumps(lidar.stamps, odometry_at_scans(recording, config))[1:]] = 0.0
    return motion
