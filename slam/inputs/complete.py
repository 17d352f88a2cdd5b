"""Which scans of a recording that is still being made are complete: no later reading changes their step."""

from __future__ import annotations

import numpy as np

from moteslam.robot.recording import Recording
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import odometry_path
from moteslam.slam.inputs.synchronise import require_lidar, sweep_seconds

SILENT = 1.0
"""A gyro that is this far behind the wheels [s] has ended, and is not waited for."""


def complete_scans(recording: Recording, config: SyncConfig | None = None) -> int:
    """How many scans, from the first on, are covered by the readings of wheels, odometry and gyro.

    The pose at a scan lies between two readings, and so does that at the end of its sweep where scans are de-skewed.

    Args:
        recording: as it is now.
        config: of the synchronisation; the defaults if None.

    Raises:
        InputError: no scans, or encoders without wheels.
    """
    config = config or SyncConfig()
    lidar = require_lidar(recording)
    path = odometry_path(recording, config)
    if path is None:
        return len(lidar)
    covered = float(path.stamps[-1])
    if path.stamps is getattr(recording.encoders, "stamps", None) and recording.imu is not None and len(recording.imu):
        gyro = float(recording.imu.stamps[-1])
        if covered - gyro < SILENT:  # a turn between two readings of the wheels is the gyro's
            covered = float(path.stamps[max(np.searchsorted(path.stamps, gyro, side="right") - 1, 0)])
    ends = lidar.stamps + (sweep_seconds(recording, lidar) if config.deskew else 0.0)
    return int(np.searchsorted(ends, covered, side="right"))
