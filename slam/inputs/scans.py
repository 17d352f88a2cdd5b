"""The endpoints of any scan of a recording in the robot's frame, as if the scan had been taken at once."""

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LidarStream
from moteslam.robot.se2 import Array
from moteslam.slam.inputs.travelling import Follower


class Scans:
    """Scans as points, de-skewed where the motion during a sweep is known.

    ``sweeps`` [n, 3] is the robot's motion while each scan is taken, in its frame at the first beam; None for scans
    that count as taken at once. Endpoints beyond ``max_range`` [m] are left out, and what travels with the robot.
    """

    def __init__(
        self,
        lidar: LidarStream,
        mount: LidarSpec,
        *,
        sweeps: Array | None = None,
        max_range: float = np.inf,
        follower: Follower | None = None,
    ) -> None:
        self._lidar, self._sweeps, self._max_range, self._follower = lidar, sweeps, max_range, follower
        x, y, yaw = mount.pose
        angles = lidar.angles + yaw
        self._directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        self.origin = np.array([x, y])  # where the rays start, in the robot's frame [m]

    def ranges(self, index: int) -> NDArray[np.float32]:
        """Of a scan [beams] [m]; NaN where an endpoint is left out."""
        ranges = self._some(index, index + 1)[0][0]
        return np.where(ranges <= self._max_range, ranges, np.float32(np.nan))

    def points(self, index: int) -> NDArray[np.float32]:
        """The finite endpoints [k, 2] of a scan [m], in the robot's frame at the scan's stamp."""
        ranges, sweeps = self._some(index, index + 1)
        good = np.isfinite(ranges[0]) & (ranges[0] <= self._max_range)
        points: Array = self.origin + ranges[0][good, None] * self._directions[good]
        if sweeps is not None:
            x, y, turn = sweeps[0]
            share = np.flatnonzero(good) / max(len(good) - 1, 1)
            cos, sin = np.cos(turn * share), np.sin(turn * share)
            points = np.stack(
                (
                    cos * points[:, 0] - sin * points[:, 1] + x * share,
                    sin * points[:, 0] + cos * points[:, 1] + y * share,
                ),
                axis=1,
            )
        return points.astype(np.float32)

    def silent(self, index: int) -> NDArray[np.float32]:
        """Where the beams of a scan that nothing answered [k, 2] reach the largest range [m], in the robot's frame."""
        beyond = np.isposinf(self._some(index, index + 1)[0][0])
        reach = min(self._lidar.range_max, self._max_range)
        return np.asarray(self.origin + reach * self._directions[beyond], np.float32)

    def block(self, first: int, last: int) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
        """The finite endpoints [k, 2] [m] of scans from ``first`` to before ``last``, projected in one launch: each in
        the robot's frame at the scan's stamp. And of each scan [n] its first row in them, and how many are its.
        """
        from moteslam.kernels.scans import project_scans

        ranges, sweeps = self._some(first, last)
        points, counts = project_scans(ranges, self._directions, self.origin, sweeps=sweeps, max_range=self._max_range)
        return points, np.arange(len(counts), dtype=np.int32) * ranges.shape[1], counts

    def _some(self, first: int, last: int) -> tuple[NDArray[np.float32], Array | None]:
        """The ranges [m, beams] of some scans without what travels with the robot, and its sweeps [m, 3]."""
        ranges = self._lidar.ranges[first:last]
        if self._follower is not None:
            ranges = np.stack([without(each, self._follower.hides(first + k, each)) for k, each in enumerate(ranges)])
        return ranges, None if self._sweeps is None else self._sweeps[first:last]


def without(ranges: NDArray[np.float32], hidden: NDArray[np.bool_] | None) -> NDArray[np.float32]:
    """Ranges [beams] [m] with NaN where they are hidden [beams]."""
    return ranges if hidden is None else np.where(hidden, np.float32(np.nan), ranges)
