"""Where the robot would think it is by its odometry alone: what SLAM has to beat."""

from __future__ import annotations

import numpy as np

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import odometry_path
from moteslam.slam.inputs.synchronise import Inputs, synchronise


def dead_reckon(recording: Recording, config: SyncConfig | None = None) -> Trajectory:
    """The trajectory of dead reckoning, starting at the identity (figures 5 and 6 of the paper).

    Args:
        recording: with encoders or odometry; a lidar is not needed.
        config: how the streams are synchronised; proper interpolation by default.

    Returns:
        poses at every scan, or at every odometry reading where there are no scans.

    Raises:
        InputError: there is no odometry of any kind, or the streams do not overlap in time.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    config = config or SyncConfig()
    path = odometry_path(recording, config)
    if path is None:
        raise InputError("neither encoders nor odometry, expected one of them", file=recording.name)
    if recording.lidar is not None and len(recording.lidar):
        return dead_reckoning(synchronise(recording, config))
    return Trajectory(path.stamps, np.asarray(se2.between(path.poses[0], path.poses)))


def dead_reckoning(inputs: Inputs) -> Trajectory:
    """Dead reckoning at every scan, starting at the identity; standing still where there is no odometry."""
    return Trajectory(inputs.stamps, np.asarray(se2.between(inputs.odometry[0], inputs.odometry)))
