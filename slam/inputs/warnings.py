"""What SLAM has to make do with in a recording: scans that no sensor of motion covers, or that see nothing."""

from __future__ import annotations

import numpy as np

from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, Recording
from moteslam.slam.inputs.synchronise import Inputs

GYRO_MARGIN = 3.0
"""Encoder readings this far outside the gyro's time count as covered [s]: a real robot's encoders run on for 1.5 s."""
ENCODER_MARGIN = 0.1
"""Scans this far outside the encoders' time count as covered [s]."""


def warnings(recording: Recording, inputs: Inputs) -> tuple[str, ...]:
    """What SLAM has to make do with, a line each.

    Args:
        recording: as it was read.
        inputs: the same, synchronised.
    """
    lidar, encoders = recording.lidar, recording.encoders
    assert lidar is not None
    lines = _about_scans(lidar)
    if encoders is not None and len(encoders):
        lines += _about_encoders(encoders, recording.imu)
        if lidar.odometry is None:
            lines += _uncovered(lidar, encoders)
    if inputs.path is None:
        lines.append(f"no odometry: constant velocity over {len(lidar)} scans; dead reckoning stands still")
    elif not inputs.moves:
        lines.append(f"odometry that never moves: constant velocity over {len(lidar)} scans")
    return tuple(lines)


def _about_scans(lidar: LidarStream) -> list[str]:
    lines = []
    blind = int((~np.isfinite(lidar.ranges).any(axis=1)).sum())
    if blind:
        lines.append(f"{blind} of {len(lidar)} scans see nothing: the odometry is all that is known there")
    if len(lidar) > 2 and lidar.stamps[0] == lidar.stamps[-1] and lidar.odometry is None:
        lines.append(f"all {len(lidar)} scans have the same stamp: there is no motion between them")
    return lines


def _about_encoders(encoders: EncoderStream, imu: ImuStream | None) -> list[str]:
    without = len(encoders)
    if imu is not None and len(imu) > 1:
        covered = (encoders.stamps > imu.stamps[0] - GYRO_MARGIN) & (encoders.stamps < imu.stamps[-1] + GYRO_MARGIN)
        without = int((~covered).sum())
    if not without:
        return []
    return [f"{without} of {len(encoders)} encoder readings without a gyro: there the wheels alone turn it"]


def _uncovered(lidar: LidarStream, encoders: EncoderStream) -> list[str]:
    counts = {
        "before the first": int((lidar.stamps < encoders.stamps[0] - ENCODER_MARGIN).sum()),
        "after the last": int((lidar.stamps > encoders.stamps[-1] + ENCODER_MARGIN).sum()),
    }
    return [
        f"{count} scans {when} encoder reading: the robot is taken to stand still"
        for when, count in counts.items()
        if count
    ]
