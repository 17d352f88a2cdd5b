"""What a recording lacks for SLAM: scans that no motion sensor covers, or that have no endpoint."""

from __future__ import annotations

import numpy as np

from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, Recording, chunks
from moteslam.robot.values import Issue, when
from moteslam.slam.inputs.synchronise import Inputs

GYRO_MARGIN = 3.0
"""Encoder readings this far outside the gyro's time count as covered [s]: a real robot's encoders run on for 1.5 s."""
ENCODER_MARGIN = 0.1
"""Scans this far outside the encoders' time count as covered [s]."""


def warnings(recording: Recording, inputs: Inputs) -> tuple[Issue, ...]:
    """What SLAM has to do without, or takes as something else.

    Args:
        recording: as it was read.
        inputs: the same, synchronised.
    """
    lidar, encoders = recording.lidar, recording.encoders
    assert lidar is not None
    issues = _about_scans(lidar)
    if encoders is not None and len(encoders):
        issues += _about_encoders(encoders, recording.imu)
        if lidar.odometry is None:
            issues += _uncovered(lidar, encoders)
    if inputs.path is None:
        text = f"no odometry: constant velocity over {len(lidar)} scans; dead reckoning stands still"
        issues.append(Issue("no-odometry", text, len(lidar)))
    elif not inputs.moves:
        scans = int((~inputs.measured).sum())
        if scans:
            text = f"odometry that never moves: constant velocity over {scans} scans"
            issues.append(Issue("still-odometry", text, scans))
    return (*issues, *inputs.issues)


def about_jumps(inputs: Inputs, scans: int) -> tuple[Issue, ...]:
    """Where the odometry jumps among the first ``scans`` scans, and a filter does without it."""
    at = np.flatnonzero(inputs.jumped[:scans]).tolist()
    if not at:
        return ()
    spans = [(float(inputs.stamps[scan - 1]), float(inputs.stamps[scan])) for scan in at]
    text = f"odometry jumps at {len(at)} of {scans} scans: constant velocity there; {when(spans)}"
    return (Issue("odometry-jumps", text, len(at)),)


def _about_scans(lidar: LidarStream) -> list[Issue]:
    issues = []
    blind = sum(int((~np.isfinite(scans).any(axis=1)).sum()) for scans in chunks(lidar.ranges))
    if blind:
        text = f"{blind} of {len(lidar)} scans without an endpoint: odometry alone there"
        issues.append(Issue("blind-scans", text, blind))
    if len(lidar) > 2 and lidar.stamps[0] == lidar.stamps[-1] and lidar.odometry is None:
        text = f"all {len(lidar)} scans have the same stamp: there is no motion between them"
        issues.append(Issue("equal-stamps", text, len(lidar)))
    return issues


def _about_encoders(encoders: EncoderStream, imu: ImuStream | None) -> list[Issue]:
    without = len(encoders)
    if imu is not None and len(imu) > 1:
        covered = (encoders.stamps > imu.stamps[0] - GYRO_MARGIN) & (encoders.stamps < imu.stamps[-1] + GYRO_MARGIN)
        without = int((~covered).sum())
    if not without:
        return []
    text = f"{without} of {len(encoders)} encoder readings without a gyro: turns from the wheels alone there"
    return [Issue("no-gyro", text, without)]


def _uncovered(lidar: LidarStream, encoders: EncoderStream) -> list[Issue]:
    counts = {
        "before the first": int((lidar.stamps < encoders.stamps[0] - ENCODER_MARGIN).sum()),
        "after the last": int((lidar.stamps > encoders.stamps[-1] + ENCODER_MARGIN).sum()),
    }
    return [
        Issue("no-encoders", f"{count} scans {when} encoder reading: taken to stand still", count)
        for when, count in counts.items()
        if count
    ]
