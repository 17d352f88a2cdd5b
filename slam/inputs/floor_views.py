"""What the camera last saw of the floor when a scan is taken: the newest frame, read when a filter asks for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import CameraSpec
from moteslam.robot.recording import RgbdStream
from moteslam.robot.rgbd import CameraFrame, FrameCount, pairs, read_frame
from moteslam.robot.values import Issue
from moteslam.slam.inputs.inputs import Inputs


@dataclass(frozen=True, eq=False)
class FloorView:
    """A frame of the floor, and where the robot was when it was taken."""

    frame: CameraFrame  # what the camera saw
    mount: CameraSpec  # of the camera
    place: NDArray[np.float64]  # [3] of the robot at the frame, in its frame at the scan, by the odometry
    age: float  # from frame to scan [s]

    def corrected(self, odometry: NDArray[np.float64], motion: NDArray[np.float64], seconds: float) -> FloorView:
        """The same view with its place corrected by the odometry's error, which is taken to be even over a motion.

        Args:
            odometry: [3] a motion up to the scan as the odometry measured it.
            motion: [3] the same motion as registration found it.
        """
        share = min(1.0, self.age / seconds) if seconds > 0 else 1.0
        since = se2.compose(se2.inverse(self.place), share * se2.between(odometry, motion))
        return replace(self, place=se2.inverse(since))


class FloorViews:
    """The newest frame before each scan of a recording; each frame is handed out once.

    A pixel of the colour image shows floor at the same place of the robot's frame whenever the disparity image that
    measured this place was taken: the floor is flat and the camera does not tilt. So a frame counts as taken at the
    stamp of its colours.

    Args:
        stream: gives the images, as far as they have come and are kept.
        mount: of the camera.
        largest_gap: between the colour and the disparity image of a frame [s].

    Attributes:
        count: what became of the frames that were asked for.
        asked: how many scans a frame was asked for.
    """

    def __init__(
        self, stream: Callable[[], RgbdStream], mount: CameraSpec, inputs: Inputs, *, largest_gap: float
    ) -> None:
        self.count, self.asked = FrameCount(), 0
        self._stream, self._mount, self._inputs, self._largest_gap = stream, mount, inputs, largest_gap
        self._last = -np.inf

    def at(self, index: int, max_age: float) -> FloorView | None:
        """The newest frame when a scan is taken; None if it is too old, was handed out before, or is broken.

        None, too, where the odometry did not measure all of the motion in between.

        Args:
            index: of the scan; successive calls ask for rising indices.
            max_age: of the frame when the scan is taken [s].
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
        """What was lost."""
        issues = self.count.losses("colours")
        without = self.asked - self.count.used
        if without > self.asked / 2:
            text = f"colours: no new frame at {without} of {self.asked} updates: weighed without them"
            issues.append(Issue("colours-late", text, without))
        return tuple(issues)
