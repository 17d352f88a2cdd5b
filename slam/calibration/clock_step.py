"""A clock that is set forward in mid recording: its stream has a gap in which the robot did not drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.recording import Recording

Array = NDArray[np.float64]


class ClockStep(NamedTuple):
    """After a stamp [s] the clock of some streams is ahead of what it was before [s]."""

    streams: tuple[str, ...]
    stamp: float
    seconds: float

    @property
    def text(self) -> tuple[str, str]:
        """The code and the text of it."""
        text = f"{self.streams[0]}: its clock steps by {self.seconds:+.2f} s after {self.stamp:.3f} s, where nothing "
        return "clock-step", f"{text}is recorded and the robot does not drive"

    def undone(self, recording: Recording) -> Recording:
        """The recording without it."""
        gap = self.stamp + self.seconds / 2  # streams of one clock have their last readings at other stamps
        return with_stamps(recording, self.streams, lambda stamps: stamps - self.seconds * (stamps > gap))


def clock_steps(recording: Recording, least: float) -> Iterator[ClockStep]:
    """What the longest gap of scans, and that of the odometry, would be as a step of more than ``least`` [s]."""
    for streams in (("lidar",), ("odometry", "encoders", "imu")):
        stream = next((one for name in streams if (one := getattr(recording, name)) is not None), None)
        if stream is None or len(stream) < 2:
            continue
        gaps = np.diff(stream.stamps)
        longest, usual = int(np.argmax(gaps)), float(np.median(gaps))
        if gaps[longest] - usual > least:
            yield ClockStep(streams, float(stream.stamps[longest]), float(gaps[longest]) - usual)


def with_stamps(recording: Recording, names: Sequence[str], change: Callable[[Array], Array]) -> Recording:
    """The same with the stamps [n] [s] of some streams changed."""
    streams = {name: getattr(recording, name) for name in names}
    changed = {
        name: replace(stream, stamps=change(stream.stamps)) for name, stream in streams.items() if stream is not None
    }
    return recording.replace(**changed)


def with_poses(recording: Recording, change: Callable[[Array, Array], Array]) -> Recording:
    """The same with its odometry's poses [n, 3], and those logged with scans, changed, at stamps [n] [s]."""
    lidar, odometry = recording.lidar, recording.odometry
    if lidar is not None and lidar.odometry is not None:
        lidar = replace(lidar, odometry=change(lidar.stamps, lidar.odometry))
    if odometry is not None:
        odometry = replace(odometry, poses=change(odometry.stamps, odometry.poses))
    return recording.replace(lidar=lidar, odometry=odometry)
