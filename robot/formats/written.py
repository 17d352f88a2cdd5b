"""What formats cannot hold of a recording, as issues of writing it; and the odometry that it is written with."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from moteslam.robot.recording import OdometryStream, Recording, RgbdStream
from moteslam.robot.values import Issue, counted
from moteslam.robot.wheel_odometry import wheel_path

_WORDS = {"encoders": "encoder reading", "odometry": "odometry pose", "imu": "IMU reading", "rgbd": "image"}


def not_written(recording: Recording, where: str, streams: Iterable[str]) -> tuple[Issue, ...]:
    """An issue for each of some streams that the recording has, and that cannot be written to ``where``."""
    issues = []
    for name in streams:
        stream = getattr(recording, name)
        is_images = isinstance(stream, RgbdStream)
        count = (
            len(stream.rgb_stamps) + len(stream.disparity_stamps) if is_images else 0 if stream is None else len(stream)
        )
        if count:
            issues.append(left_out(recording, where, counted(count, _WORDS[name]), count))
    return tuple(issues)


def left_out(recording: Recording, where: str, what: str, count: int = 1) -> Issue:
    """The issue that something of a recording has no place where it was written."""
    return Issue("not-written", f"{recording.name}: {what} not written, no place in {where}", count)


@dataclass(frozen=True, eq=False)
class WrittenOdometry:
    """The odometry that a bag gets; ``is_computed`` where the recording has not these poses."""

    stream: OdometryStream | None
    is_computed: bool = False
    issues: tuple[Issue, ...] = ()


def odometry_of(recording: Recording) -> WrittenOdometry:
    """The recording's odometry, else that of its wheels, else the poses that were logged with the scans."""
    if recording.odometry is not None and len(recording.odometry):
        return WrittenOdometry(recording.odometry)
    if (computed := computed_odometry(recording)) is not None:
        return WrittenOdometry(computed, is_computed=True)
    lidar = recording.lidar
    if lidar is not None and lidar.odometry is not None and len(lidar):
        issue = Issue("scan-poses", f"{recording.name}: the poses of the scans are written as odometry", len(lidar))
        return WrittenOdometry(OdometryStream(lidar.stamps, lidar.odometry), issues=(issue,))
    issue = Issue("no-odometry", f"{recording.name}: neither odometry nor wheels: no /odom is written")
    return WrittenOdometry(None, is_computed=True, issues=(issue,))


def computed_odometry(recording: Recording) -> OdometryStream | None:
    """Dead reckoning by the wheels, and by the gyro while it measures; None where there are no wheels to compute it of.

    The wheels' own turns are taken where there is no gyro: `wheel_path`.
    """
    encoders = recording.encoders
    if encoders is None or not len(encoders) or recording.platform.wheels is None:
        return None
    return OdometryStream(encoders.stamps, wheel_path(recording))
