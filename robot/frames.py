"""The frames of an RGB-D stream: a disparity image with the colour image nearest to it, decoded as they are needed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.issues import Issue
from moteslam.robot.processors import processor_count
from moteslam.robot.recording import RgbdStream
from moteslam.robot.stamps import nearest_stamp
from moteslam.robot.summary import Summarised
from moteslam.robot.wording import counted

LARGEST_GAP = 0.05
"""A colour image further from the disparity image than this [s] shows another view (the real one's cameras lose
frames of their own, for 0.2 s at a time)."""


@dataclass(frozen=True, eq=False, repr=False)
class CameraFrame(Summarised):
    """What the camera saw at a moment.

    Attributes:
        stamp: of the disparity image [s].
        rgb_stamp: of the colour image [s].
        disparity: [480, 640] uint16, raw.
        rgb: [480, 640, 3] uint8, red, green, blue.
    """

    stamp: float
    rgb_stamp: float
    disparity: NDArray[np.uint16]
    rgb: NDArray[np.uint8]


@dataclass(eq=False)
class FrameCount:
    """What became of the frames while they were read.

    Attributes:
        used: that were handed out.
        unpaired: without a colour image near enough.
        missing: without a file for one of the images.
        unreadable: an image of which could not be decoded.
        first_unreadable: what was wrong with the first of them.
    """

    used: int = 0
    unpaired: int = 0
    missing: int = 0
    unreadable: int = 0
    first_unreadable: str = field(default="")

    def note(self, frame: CameraFrame | str | None) -> None:
        """Count what ``read_frame`` gave."""
        if isinstance(frame, CameraFrame):
            self.used += 1
        elif frame is None:
            self.missing += 1
        else:
            self.unreadable += 1
            self.first_unreadable = self.first_unreadable or frame

    def issues(self) -> tuple[Issue, ...]:
        """One for each kind of loss that happened."""
        issues = []
        if self.missing:
            text = f"camera: {counted(self.missing, 'frame')} left out, an image of theirs is missing"
            issues.append(Issue("frames-incomplete", text, self.missing))
        if self.unreadable:
            left = counted(self.unreadable, "frame")
            text = f"camera: {left} left out, unreadable; the first: {self.first_unreadable}"
            issues.append(Issue("frames-unreadable", text, self.unreadable))
        if not self.used:
            issues.append(Issue("no-frames", "camera: not a single frame could be used"))
        return tuple(issues)


def has_images(stream: RgbdStream | None) -> bool:
    """Whether there are both colour and disparity images, and not just stamps."""
    if stream is None:
        return False
    return stream.images is not None or (any(stream.rgb_files) and any(stream.disparity_files))


def pairs(
    stream: RgbdStream, *, interval: float = 0.0, largest_gap: float = LARGEST_GAP
) -> tuple[NDArray[np.intp], NDArray[np.intp], int]:
    """Which colour image belongs to which disparity image: the nearest in time.

    Args:
        stream: the stamps.
        interval: shortest time between two disparity images that are chosen [s], give or take a quarter of a frame.
        largest_gap: between the two images of a frame [s].

    Returns:
        indices of the disparity images and of their colour images, and how many had none near enough.
    """
    rgb, disparity = stream.rgb_stamps, stream.disparity_stamps
    if not len(rgb) or not len(disparity):
        return np.empty(0, np.intp), np.empty(0, np.intp), len(disparity)
    nearest = nearest_stamp(rgb, disparity)
    near = np.abs(disparity - rgb[nearest]) <= largest_gap
    slack = 0.25 * float(np.median(np.diff(disparity))) if len(disparity) > 1 else 0.0
    chosen, last = [], -np.inf
    for index in np.flatnonzero(near):
        if disparity[index] - last >= interval - slack:
            chosen.append(index)
            last = disparity[index]
    kept = np.asarray(chosen, np.intp)
    return kept, nearest[kept], int((~near).sum())


def read_frame(stream: RgbdStream, disparity: int, rgb: int) -> CameraFrame | str | None:
    """The frame of a disparity image and a colour image.

    Args:
        stream: stamps and images.
        disparity, rgb: indices of the two images, see ``pairs``.

    Returns:
        the frame; None where an image is missing; what is wrong with the first image that cannot be decoded.
    """
    from moteslam.robot.formats.ucsd_images import read_disparity, read_rgb

    stamps = float(stream.disparity_stamps[disparity]), float(stream.rgb_stamps[rgb])
    if stream.images is not None:
        try:
            return CameraFrame(*stamps, stream.images.disparity(disparity), stream.images.rgb(rgb))
        except InputError as error:
            return str(error)
    images: list[NDArray[Any]] = []
    sources: tuple[tuple[tuple[Path | None, ...], int, Callable[[Path], NDArray[Any]]], ...] = (
        (stream.disparity_files, disparity, read_disparity),
        (stream.rgb_files, rgb, read_rgb),
    )
    for files, index, read in sources:
        path = files[index] if files else None
        if path is None:
            return None
        try:
            images.append(read(path))
        except InputError as error:
            return str(error)
    return CameraFrame(*stamps, images[0], images[1])


def camera_frames(
    stream: RgbdStream, *, interval: float = 0.0, largest_gap: float = LARGEST_GAP, count: FrameCount | None = None
) -> Iterator[CameraFrame]:
    """The frames in the order of their stamps, decoded on all cores a little ahead; a few are held at a time.

    An image that is missing or cannot be read leaves its frame out; ``count`` counts it.

    Args:
        stream: stamps and files.
        interval, largest_gap: see ``pairs``.
        count: counts what became of the frames.
    """
    count = count if count is not None else FrameCount()
    depth, colour, count.unpaired = pairs(stream, interval=interval, largest_gap=largest_gap)
    cores = processor_count()

    with ThreadPoolExecutor(cores) as pool:
        ahead: deque[Future[CameraFrame | str | None]] = deque()
        todo = iter(zip(depth.tolist(), colour.tolist(), strict=True))
        try:
            while True:
                while len(ahead) < 2 * cores + 2 and (pair := next(todo, None)) is not None:
                    ahead.append(pool.submit(read_frame, stream, *pair))
                if not ahead:
                    return
                frame = ahead.popleft().result()
                count.note(frame)
                if isinstance(frame, CameraFrame):
                    yield frame
        finally:
            pool.shutdown(cancel_futures=True)
