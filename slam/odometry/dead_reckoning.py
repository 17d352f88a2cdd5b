"""Where the robot would think it is by its odometry alone: what SLAM has to beat."""

from __future__ import annotations

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import odometry_path
from moteslam.slam.inputs.synchronise import synchronise


def dead_reckon(recording: Recording, config: SyncConfig | None = None) -> Trajectory:
    """The trajectory of dead reckoning, starting at the identity (figures 5 and 6 of the paper).

    At every scan, or at every odometry reading where there are no scans. Refused is a recording without any odometry,
    or whose streams do not overlap in time.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    config = config or SyncConfig()
    path = odometry_path(recording, config)
    if path is None:
        raise InputError("neither encoders nor odometry, expected one of them", file=recording.name)
    if recording.lidar is not None and len(recording.lidar):
        inputs = synchronise(recording, config)
        return dead_reckoning(inputs.stamps, inputs.odometry)
    return dead_reckoning(path.stamps, path.poses)


def dead_reckoning(stamps: Array, odometry: Array) -> Trajectory:
    """Poses [n, 3] by odometry at stamps [n] [s], starting at the identity."""
    return Trajectory(stamps, se2.between(odometry[0], odometry))
