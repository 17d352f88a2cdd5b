"""The endpoints of all nodes' scans in one array, and the sharpness of the map that they draw along a path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.normals import scan_normals
from moteslam.kernels.scans import ThinnedScan
from moteslam.robot.raster import cell_counts
from moteslam.robot.se2 import Array

NORMAL_REACH, NORMAL_NOISE, NORMAL_LARGEST = 0.3, 0.005, 0.1
"""See ``scan_normals``: 30 cm of wall, points good to 5 mm, directions good to 0.1 rad."""
SHARPNESS_CELL = 0.05  # Edge of the cells [m]


class Endpoints(NamedTuple):
    """The endpoints of n scans, scan by scan."""

    points: NDArray[np.float32]  # [p, 2] in the robot's frame of each scan
    normals: NDArray[np.float32]  # [p, 2] likewise
    starts: NDArray[np.int32]  # int32 [n + 1] of each scan among them, and p
    owners: NDArray[np.int32]  # int32 [p] the scan of each

    @classmethod
    def of(cls, scans: Sequence[ThinnedScan]) -> Endpoints:
        """Of thinned scans, with their normals."""
        counts = [len(scan.points) for scan in scans]
        points = np.vstack([scan.points for scan in scans])
        joined = np.concatenate([scan.joined for scan in scans]).astype(np.int32)
        starts = np.r_[0, np.cumsum(counts)].astype(np.int32)
        normals = scan_normals(points, joined, starts, reach=NORMAL_REACH, noise=NORMAL_NOISE, largest=NORMAL_LARGEST)
        return cls(points, normals, starts, np.repeat(np.arange(len(scans)), counts).astype(np.int32))

    def thinned(self, every: int) -> Endpoints:
        """The first endpoint of each scan, and each ``every``-th after it."""
        kept = (np.arange(len(self.points)) - self.starts[self.owners]) % every == 0
        starts = np.r_[0, np.cumsum(kept)][self.starts].astype(np.int32)
        return Endpoints(self.points[kept], self.normals[kept], starts, self.owners[kept])

    def only(self, scans: NDArray[np.intp]) -> Endpoints:
        """Those of some scans [m], which rise; numbered anew."""
        if len(scans) == len(self.starts) - 1:
            return self
        counts = np.diff(self.starts)
        wanted = np.zeros(len(counts), bool)
        wanted[scans] = True
        kept = wanted[self.owners]
        starts = np.r_[0, np.cumsum(counts[scans])].astype(np.int32)
        owners = np.repeat(np.arange(len(scans)), counts[scans]).astype(np.int32)
        return Endpoints(self.points[kept], self.normals[kept], starts, owners)

    def placed(self, poses: Array) -> tuple[Array, Array]:
        """Points and normals [p, 2] in the map frame."""
        pose = poses[self.owners]
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])

        def turned(v: NDArray[np.float32]) -> Array:
            return np.column_stack((c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]))

        return turned(self.points) + pose[:, :2], turned(self.normals)


def sharpness(endpoints: Endpoints, poses: Array) -> float:
    """The mean number of cells that hold an endpoint: fewer are sharper, and a wall drawn twice counts twice."""
    return float(cells_along(endpoints, poses).mean())


def cells_along(endpoints: Endpoints, poses: Array) -> NDArray[np.int64]:
    """The number of cells that hold an endpoint, for each direction [GRIDS] of the grid; see ``cell_counts``."""
    return cell_counts(endpoints.placed(poses)[0], SHARPNESS_CELL)
