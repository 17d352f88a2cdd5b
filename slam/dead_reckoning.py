"""Where the robot would think it is by its odometry alone: what SLAM has to beat."""

from __future__ import annotations

import numpy as np

from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.config import SyncConfig
from moteslam.slam.synchronise import odometry_at_scans, odometry_path


def dead_reckon(recording: Recording, config: SyncConfig | None = None) -> Trajectory:
    """The trajectory of dead reckoning, starting at the identity (figures 5 and 6 of the paper).

    Args:
        recording: with encoders or odometry; a lidar is not needed.
        config: how the streams are synchronised; proper interpolation by default.

    Returns:
        poses at every scan, or at every odometry reading where there are no scans.

    Raises:
        InputError: there is no odometry of any kind.
    """
    config = config or SyncConfig()
    if recording.lidar is not None and len(recording.lidar):
        stamps, poses = recording.lidar.stamps, odometry_at_scans(recording, config)
    else:
        stamps, poses = odometry_path(recording, config)
    return Trajectory(stamps, np.asarray(se2.between(poses[0], poses)))
