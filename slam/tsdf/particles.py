"""The particles of the filter: N hypotheses of the robot's path, each with the TSDF that follows from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.filter.history import History
from moteslam.slam.filter.weights import Weights
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfMaps

Array = NDArray[np.float64]


class Particles:
    """N particles at the identity, where the robot starts, with one empty map that all share.

    Attributes:
        poses: [N, 3] at the last update.
        weights: of the particles.
        best: index of the best one.
        hypotheses: [N] numbers of the places that they were sent to; equal where a search left no choice.
        maps: their TSDFs.
        history: their poses at every update.
    """

    def __init__(self, n: int, config: TsdfConfig) -> None:
        self._config = config
        self.poses = np.zeros((n, 3))
        self.weights = Weights.uniform(n)
        self.hypotheses = np.zeros(n, np.int64)
        self.best = 0
        self.maps = TsdfMaps(config)
        self.history = History()

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def best_pose(self) -> Array:
        """The pose [3] of the best particle."""
        return np.array(self.poses[self.best])

    def offsets(self) -> Array:
        """Of all particles from the best one, in its frame [N, 3]."""
        return np.asarray(se2.between(self.poses[self.best], self.poses))

    def mode_mean(self, distance: float, rotation: float) -> Array:
        """The weighted mean [3] of the best particle's mode, in the frame of the best particle.

        Args:
            distance: of the particles of its mode from it, at most [m].
            rotation: of their headings from its heading, at most [rad].
        """
        if len(self) == 1:
            return np.zeros(3)
        off = self.offsets()
        near = (np.hypot(off[:, 0], off[:, 1]) <= distance) & (abs(off[:, 2]) <= rotation)
        weights = self.weights.values * near
        return np.asarray(weights @ off / weights.sum())

    def start(self, scan: ThinnedScan) -> None:
        """The first update: the scan goes into the one map that all particles share."""
        self.history.append(self.poses)
        self.maps.integrate(self.poses[:1], scan)
        self.maps.resample(np.zeros(len(self), np.int64))

    def begin_anew(self, pose: Array, scan: ThinnedScan) -> None:
        """An update without the maps so far: all particles at one pose [3], with a map of this scan alone."""
        self.poses = np.repeat(pose[None], len(self), axis=0)
        self.hypotheses[:] = 0
        self.weights = Weights.uniform(len(self))
        self.maps = TsdfMaps(self._config)
        self.start(scan)

    def revise(self, path: Array, scans: Sequence[ThinnedScan]) -> None:
        """Move all particles by the correction of the best one's path, and redraw one map along it for all of them.

        Args:
            path: [u, 3] poses at every update, corrected.
            scans: the scans of the latest of these updates, which are drawn.
        """
        last = self.best_pose
        self.history.revise(self.history.path(self.best), path)
        self.poses = se2.compose(path[-1], se2.between(last, self.poses))
        self.hypotheses[:] = 0
        self.maps = TsdfMaps(self._config)
        self.maps.draw(path[len(path) - len(scans) :], scans)
        self.maps.resample(np.zeros(len(self), np.int64))

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Replace the particles by the children of these [M], with equal weights."""
        # the best one itself, unless the draw left it out
        self.best = int(self.weights.values[parents].argmax())
        self.poses, self.weights = self.poses[parents], Weights.uniform(len(parents))
        self.hypotheses = self.hypotheses[parents]
        self.history.resampled(parents)
        self.maps.resample(parents)

    def move_to(self, poses: Array) -> None:
        """Enter the poses [N, 3] of an update."""
        self.poses = poses
        self.history.append(poses)

    def integrate(self, scan: ThinnedScan) -> None:
        """Average a scan into every particle's TSDF from its pose."""
        self.maps.integrate(self.poses, scan)
