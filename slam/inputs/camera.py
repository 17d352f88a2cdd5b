"""What the camera last saw of the floor when a scan is taken: the newest frame, read when a filter asks for it.

And images as they come: the latest ones, and a file of those that the floor is coloured by.
"""

import os
import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from tempfile import TemporaryFile
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import CameraSpec
from moteslam.robot.raster import encode_png
from moteslam.robot.recording import Images, RgbdStream, nearest_stamp
from moteslam.robot.rgbd import (
    HEIGHT,
    WIDTH,
    CameraFrame,
    FrameChoice,
    FrameCount,
    decode_disparity,
    decode_rgb,
    disparity_of,
    pairs,
    read_frame,
)
from moteslam.robot.values import Issue
from moteslam.slam.inputs.inputs import Inputs


@dataclass(frozen=True, eq=False)
class FloorView:
    """A frame of the floor, and where the robot was when it was taken."""

    frame: CameraFrame  # what the camera saw
    mount: CameraSpec  # of the camera
    place: NDArray[np.float64]  # [3] of the robot at the frame, in its frame at the scan, by the odometry
    age: float  # from frame to scan [s]

    def corrected(self, odometry: NDArray[np.float64], motion: NDArray[np.float64], seconds: float) -> Self:
        """The same view with its place corrected by the odometry's error, which is taken to be even over a motion.

        That is up to the scan: [3] as the odometry measured it, and [3] as registration found it.
        """
        share = min(1.0, self.age / seconds) if seconds > 0 else 1.0
        since = se2.compose(se2.inverse(self.place), share * se2.between(odometry, motion))
        return replace(self, place=se2.inverse(since))


class FloorViews:
    """The newest frame before each scan of a recording; each is handed out once.

    A pixel of the colour image shows floor at the same place of the robot's frame whenever the disparity image that
    measured this place was taken: the floor is flat and the camera does not tilt. So a frame counts as taken at the
    stamp of its colours.

    The stream has the images as far as they have come and are kept; ``largest_gap``: between the colour and the
    disparity image of a frame [s].
    """

    def __init__(
        self, stream: Callable[[], RgbdStream], mount: CameraSpec, inputs: Inputs, *, largest_gap: float
    ) -> None:
        self.count, self.asked = FrameCount(), 0  # what became of the frames; for how many scans one was asked for
        self._stream, self._mount, self._inputs, self._largest_gap = stream, mount, inputs, largest_gap
        self._last = -np.inf

    def at(self, index: int, max_age: float) -> FloorView | None:
        """The newest frame when a scan is taken; None if it is older than ``max_age`` [s], was handed out before, or is
        broken.

        None, too, where the odometry did not measure all of the motion in between. Indices of scans rise from call to
        call.
        """
        self.asked += 1
        inputs, stream = self._inputs, self._stream()
        stamp, path = float(inputs.stamps[index]), inputs.path
        since = stamp - max_age - 2 * self._largest_gap
        both = (stream.disparity_stamps, stream.rgb_stamps)
        (first, last), (begin, end) = (np.searchsorted(each, (since, stamp), side="right") for each in both)
        near = RgbdStream(stream.rgb_stamps[begin:end], stream.disparity_stamps[first:last])
        depth, colour = pairs(near, largest_gap=self._largest_gap)
        shown = near.disparity_stamps[depth]
        # later on no colour image nearer to the disparity image can arrive any more
        whole = np.flatnonzero(shown + np.abs(near.rgb_stamps[colour] - shown) <= stamp)
        if path is None or not len(whole):
            return None
        newest = whole[-1]
        taken = float(near.rgb_stamps[colour[newest]])  # that several disparity images may have as their nearest
        if taken <= self._last or stamp - taken > max_age:
            return None
        before = max(int(np.searchsorted(inputs.stamps, taken, side="right")) - 1, 0)
        if not inputs.measured[before + 1 : index + 1].all():
            return None
        self._last = taken
        frame = read_frame(stream, int(first + depth[newest]), int(begin + colour[newest]))
        self.count.note(frame)
        if not isinstance(frame, CameraFrame):
            return None
        then, now = path.at(np.array([taken, stamp]))
        return FloorView(frame, self._mount, se2.between(now, then), stamp - taken)

    def issues(self) -> tuple[Issue, ...]:
        issues = self.count.losses("colours")
        without = self.asked - self.count.used
        if without > self.asked / 2:
            text = f"colours: no new frame at {without} of {self.asked} updates: weighed without them"
            issues.append(Issue("colours-late", text, without))
        return tuple(issues)


BEHIND = 1.0  # Images are kept for so much longer than a scan waits [s]: a filter asks for frames from before a scan
RGB, DISPARITY = "rgb", "disparity"


class LiveCamera:
    """Takes in images; what is held in memory, for so long as they are ``kept`` [s], does not grow with their number.

    Interval and largest gap are of the frames that colour the floor [s]: see `FrameChoice`.
    """

    def __init__(self, interval: float, largest_gap: float, kept: float) -> None:
        self._choice, self._kept = FrameChoice(interval, largest_gap), kept
        self._latest: dict[str, deque[tuple[float, NDArray[Any]]]] = {RGB: deque(), DISPARITY: deque()}
        self._undecided = 0  # of the latest disparity images: their colours may be still to come
        self._newest = -np.inf
        self._file = TemporaryFile(buffering=0)  # noqa: SIM115 - it goes with this object
        weakref.finalize(self, self._file.close)
        self._places: dict[str, list[tuple[float, int, int]]] = {RGB: [], DISPARITY: []}  # stamp, offset, bytes

    def add(self, kind: str, stamp: float, image: NDArray[Any]) -> None:
        self._latest[kind].append((stamp, image))
        self._undecided += kind == DISPARITY
        self._newest = max(self._newest, stamp)
        self.decide(self._newest - self._kept)
        for images in self._latest.values():
            while images and images[0][0] < self._newest - self._kept:
                images.popleft()

    @property
    def latest(self) -> RgbdStream:
        """The images that are in memory."""
        rgb, disparity = (list(self._latest[kind]) for kind in (RGB, DISPARITY))
        colours, shown = (np.array([stamp for stamp, _ in images]) for images in (rgb, disparity))
        return RgbdStream(colours, shown, images=Images(lambda k: rgb[k][1], lambda k: disparity[k][1]))

    def used(self) -> RgbdStream:
        """The frames that the floor is coloured by, as far as they are chosen."""
        colours, shown = (np.array([stamp for stamp, _, _ in self._places[kind]]) for kind in (RGB, DISPARITY))
        read = Images(lambda k: decode_rgb(self._read(RGB, k)), lambda k: decode_disparity(self._read(DISPARITY, k)))
        return RgbdStream(colours, shown, images=read)

    def decide(self, waited: float) -> None:
        """Choose among the disparity images whose colours have come, or that are older than a stamp [s]."""
        colours = self._latest[RGB]
        while self._undecided:
            stamp, image = self._latest[DISPARITY][-self._undecided]
            if not (colours and colours[-1][0] >= stamp) and stamp >= waited:
                return
            self._undecided -= 1
            stamps = np.array([each for each, _ in colours])
            shown, colour = colours[int(nearest_stamp(stamps, np.array([stamp]))[0])] if colours else (np.inf, image)
            if self._choice.takes(stamp, shown):
                self._write(RGB, shown, colour)
                self._write(DISPARITY, stamp, image)

    def _write(self, kind: str, stamp: float, image: NDArray[Any]) -> None:
        content = encode_png(image, fast=True)
        self._places[kind].append((stamp, self._file.seek(0, os.SEEK_END), len(content)))
        self._file.write(content)

    def _read(self, kind: str, index: int) -> bytes:
        _, offset, size = self._places[kind][index]
        return os.pread(self._file.fileno(), size, offset)  # of several threads at once


def checked_image(image: ArrayLike) -> tuple[str, NDArray[Any]]:
    """The kind of an image and a copy of it, depths [m] as disparities."""
    given = np.array(image)
    if given.shape == (HEIGHT, WIDTH, 3) and given.dtype == np.uint8:
        return RGB, given
    if given.shape == (HEIGHT, WIDTH) and (given.dtype == np.uint16 or given.dtype.kind == "f"):
        return DISPARITY, given if given.dtype == np.uint16 else disparity_of(given)
    expected = f"[{HEIGHT}, {WIDTH}, 3] uint8 colours, or [{HEIGHT}, {WIDTH}] uint16 disparities or depths in m"
    raise InputError(f"{given.dtype} {list(given.shape)}, expected {expected}", field="image")
