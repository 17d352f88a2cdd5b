"""The odometry that a recording is written with, where a format holds poses: its own, or that of its wheels."""

from __future__ import annotations

from dataclasses import dataclass

from moteslam.robot.recording import OdometryStream, Recording
from moteslam.robot.values import Issue
from moteslam.robot.wheel_odometry import wheel_path


@dataclass(frozen=True, eq=False)
class WrittenOdometry:
    """The odometry that a bag or a log gets.

    Attributes:
        stream: of it; None where there is none.
        is_stream: whether the recording has these poses; those that are computed of the wheels it has not.
        issues: what does not come back as it was.
    """

    stream: OdometryStream | None
    is_stream: bool
    issues: tuple[Issue, ...] = ()


def odometry_of(recording: Recording) -> WrittenOdometry:
    """The recording's odometry, else that of its wheels, else the poses that were logged with the scans."""
    if recording.odometry is not None and len(recording.odometry):
        return WrittenOdometry(recording.odometry, is_stream=True)
    lidar = recording.lidar
    if (computed := computed_odometry(recording)) is not None:
        return WrittenOdometry(computed, is_stream=False)
    if lidar is not None and lidar.odometry is not None and len(lidar):
        issue = Issue("scan-poses", f"{recording.name}: the poses of the scans are written as odometry", len(lidar))
        return WrittenOdometry(OdometryStream(lidar.stamps, lidar.odometry), is_stream=True, issues=(issue,))
    issue = Issue("no-odometry", f"{recording.name}: neither odometry nor wheels: no /odom is written")
    return WrittenOdometry(None, is_stream=False, issues=(issue,))


def computed_odometry(recording: Recording) -> OdometryStream | None:
    """Dead reckoning by the wheels, and by the gyro while it measures; None where there are no wheels to compute it of.

    The wheels' own turns are taken where there is no gyro: `wheel_path`.
    """
    encoders = recording.encoders
    if encoders is None or not len(encoders) or recording.platform.wheels is None:
        return None
    return OdometryStream(encoders.stamps, wheel_path(recording))
