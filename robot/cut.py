"""A part of a recording: from a time to a time, every n-th scan, some of its streams."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot.recording import STREAMS, ImageSource, LidarStream, Recording, RgbdStream, Stream, chosen
from moteslam.robot.values import expect_type


@dataclass(frozen=True)
class Cut:
    """Which part of a recording.

    Attributes:
        start: seconds after the recording's first stamp.
        end: likewise; infinite for its end.
        every: keep every n-th scan, for an n of at least 1.
        streams: that are kept, by their names; all where it is empty.
    """

    start: float = 0.0
    end: float = inf
    every: int = 1
    streams: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.start < inf:
            raise ConfigError(f"{self.start:g} s, expected a finite time of at least 0", field="start")
        if not self.end > self.start:
            raise ConfigError(f"{self.end:g} s, expected more than start, {self.start:g} s", field="end")
        if self.every < 1:
            raise ConfigError(f"{self.every}, expected at least 1", field="every")
        for name in self.streams:
            if name not in STREAMS:
                raise ConfigError(f"{name!r}, expected some of {', '.join(STREAMS)}", field="streams")

    @property
    def is_whole(self) -> bool:
        """Whether nothing is cut off."""
        return self == Cut()


def cut(recording: Recording, part: Cut) -> Recording:
    """The readings of a part of a recording; stamps stay as they are, and ranges and images where they are.

    Of the two images of a camera frame each is kept by its own stamp. A stream of which nothing is left is None.

    Raises:
        InputError: nothing is left of it.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    if part.is_whole:
        return recording
    present = {name: stream for name in STREAMS if (stream := getattr(recording, name)) is not None}
    kept = {name: stream for name, stream in present.items() if not part.streams or name in part.streams}
    if not kept:
        problem = f"no {' or '.join(part.streams)}, expected one of the streams it has: {', '.join(present) or 'none'}"
        raise InputError(problem, file=recording.name, field="streams")
    stamps = [stamps for stream in present.values() for stamps in _stamps(stream) if len(stamps)]
    first = min((float(some[0]) for some in stamps), default=0.0)
    last = max((float(some[-1]) for some in stamps), default=0.0)
    parts = {name: _within(stream, first + part.start, first + part.end, part.every) for name, stream in kept.items()}
    parts = {name: stream for name, stream in parts.items() if any(len(some) for some in _stamps(stream))}
    if not parts:
        problem = f"no reading from {part.start:g} to {part.end:g} s, expected times within its {last - first:.6g} s"
        raise InputError(problem, file=recording.name, field="start")
    return recording.replace(**{name: parts.get(name) for name in STREAMS})


def _stamps(stream: Stream | RgbdStream) -> list[NDArray[np.float64]]:
    return [stream.rgb_stamps, stream.disparity_stamps] if isinstance(stream, RgbdStream) else [stream.stamps]


def _within(stream: Stream | RgbdStream, begin: float, end: float, every: int) -> Stream | RgbdStream:
    """The readings of a stream from one time to another [s], both included; of scans, every n-th."""
    inside = [np.flatnonzero((stamps >= begin) & (stamps <= end)) for stamps in _stamps(stream)]
    if isinstance(stream, RgbdStream):
        rgb, disparity = inside
        return RgbdStream(
            stream.rgb_stamps[rgb],
            stream.disparity_stamps[disparity],
            tuple(stream.rgb_files[index] for index in rgb if stream.rgb_files),
            tuple(stream.disparity_files[index] for index in disparity if stream.disparity_files),
            None if stream.images is None else _SomeImages(stream.images, rgb, disparity),
        )
    indices = inside[0][:: every if isinstance(stream, LidarStream) else 1]
    values = {field.name: getattr(stream, field.name) for field in fields(stream)}
    changes: dict[str, Any] = {name: value[indices] for name, value in values.items() if isinstance(value, np.ndarray)}
    if isinstance(stream, LidarStream):
        changes["ranges"] = chosen(stream.ranges, indices)
    return replace(stream, **changes)


@dataclass(frozen=True, eq=False)
class _SomeImages:
    """The images of some of the stamps of another source, by their indices there."""

    images: ImageSource
    rgb_indices: NDArray[np.intp]
    disparity_indices: NDArray[np.intp]

    def rgb(self, index: int) -> NDArray[np.uint8]:
        return self.images.rgb(int(self.rgb_indices[index]))

    def disparity(self, index: int) -> NDArray[np.uint16]:
        return self.images.disparity(int(self.disparity_indices[index]))
