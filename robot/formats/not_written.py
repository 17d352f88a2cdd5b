"""What a format cannot hold of a recording, as issues of writing it."""

from __future__ import annotations

from collections.abc import Iterable

from moteslam.robot.recording import Recording, RgbdStream
from moteslam.robot.values import Issue, counted

_WORDS = {
    "encoders": "encoder reading",
    "odometry": "odometry pose",
    "imu": "IMU reading",
    "rgbd": "image",
}


def not_written(recording: Recording, where: str, streams: Iterable[str]) -> tuple[Issue, ...]:
    """An issue for each of some streams that the recording has.

    Args:
        recording: that was written.
        where: to what, ``a CARMEN log``.
        streams: names of those that it cannot hold.
    """
    issues = []
    for name in streams:
        stream = getattr(recording, name)
        count = 0 if stream is None else _images(stream) if isinstance(stream, RgbdStream) else len(stream)
        if count:
            issues.append(left_out(recording, where, counted(count, _WORDS[name]), count))
    return tuple(issues)


def left_out(recording: Recording, where: str, what: str, count: int = 1) -> Issue:
    """The issue that something of a recording has no place where it was written."""
    return Issue("not-written", f"{recording.name}: {what} not written, no place in {where}", count)


def _images(stream: RgbdStream) -> int:
    return len(stream.rgb_stamps) + len(stream.disparity_stamps)
