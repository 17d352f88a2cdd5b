"""The particles of the filter: N hypotheses of the robot's path, each with the TSDF that follows from it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.filter.history import History
from moteslam.slam.filter.weights import Weights
from moteslam.slam.mapping.config import APART, TsdfConfig
from moteslam.slam.mapping.tsdf import DRAWN, TsdfMaps

Thinned = Callable[[NDArray[np.intp]], list[ThinnedScan]]

OPEN = 0.001  # Weight of the particles of other hypotheses than the best from which on the place is open
PLACE, ENOUGH = 0.5, 100  # Of some twenty passes: poses within a square [m], a sector [rad] that a map is drawn from


class Particles:
    """N particles at the identity, where the robot starts, with one empty map that all share."""

    def __init__(self, n: int, config: TsdfConfig) -> None:
        self._config = config
        self.poses = np.zeros((n, 3))  # [N, 3] at the last update
        self.weights = Weights.uniform(n)  # of the particles
        # [N] numbers of the places that they were sent to, after a search that found several; else equal
        self.hypotheses = np.zeros(n, np.int64)
        self.best = 0  # index of the best one
        self.maps = TsdfMaps(config)  # their TSDFs
        self.history = History()  # their poses at every update

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def best_pose(self) -> Array:
        """The pose [3] of the best particle."""
        return np.array(self.poses[self.best])

    def offsets(self) -> Array:
        """Of all particles from the best one, in its frame [N, 3]."""
        return se2.between(self.poses[self.best], self.poses)

    def mode_mean(self, distance: float, rotation: float) -> Array:
        """The weighted mean [3] of the best particle's mode, in the frame of the best particle: of those within [m] and
        [rad].
        """
        if len(self) == 1:
            return np.zeros(3)
        off = self.offsets()
        near = (np.hypot(off[:, 0], off[:, 1]) <= distance) & (abs(off[:, 2]) <= rotation)
        weights = self.weights.values * near
        return np.asarray(weights @ off / weights.sum())

    @property
    def settled(self) -> bool:
        """Whether next to no weight is on particles of another hypothesis than the best one's."""
        others = self.hypotheses != self.hypotheses[self.best]
        return bool(self.weights.values[others].sum() < OPEN)

    def join(self) -> None:
        """Particles that have come to where the best one is are of its hypothesis."""
        if (self.hypotheses != self.hypotheses[self.best]).any():
            together = (np.abs(self.offsets()) < APART).all(axis=1)
            self.hypotheses[together] = self.hypotheses[self.best]

    def divide(self, rivals: Array, log_odds: Array) -> Array:
        """Divide the particles around the best one among rival places by their odds; the best one stays.

        The rivals [m, 3] are offsets from where that is, of log-odds [m] against it. A place where a particle is
        already is left out.

        Returns [N, 3] where each looks for the robot, from where the tracked motion leads it.
        """
        places = np.zeros((len(self), 3))
        if not len(rivals):
            return places
        off = self.offsets()
        away = off[:, None] - rivals
        away[..., 2] = se2.wrap(away[..., 2])
        free = (np.abs(away) >= APART).any(axis=2).all(axis=0)
        if not free.any():
            return places
        mode = np.flatnonzero((np.abs(off) < APART).all(axis=1))
        mode = np.append(self.best, mode[mode != self.best])
        odds = np.append(0.0, log_odds[free])
        shares = np.exp(odds - odds.max())
        chosen = np.searchsorted(np.cumsum(shares) / shares.sum(), (np.arange(len(mode)) + 0.5) / len(mode))
        chosen[0] = 0
        places[mode] = np.vstack((np.zeros(3), rivals[free]))[chosen]
        self.hypotheses[mode[chosen > 0]] = self.hypotheses.max() + chosen[chosen > 0]
        return places

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

    def drawn(self, path: Array, thinned: Thinned) -> TsdfMaps:
        """The one map along a path [u, 3], of each place the first ``ENOUGH`` scans.

        Where the robot passes again and again the map has crept with the later ones, which are placed by it.
        """
        maps, drawn = TsdfMaps(self._config), np.flatnonzero(_rank_at_place(path) < ENOUGH)
        for first in range(0, len(drawn), DRAWN):
            some = drawn[first : first + DRAWN]
            maps.draw(path[some], thinned(some))
        return maps

    def revise(self, path: Array, drawn: TsdfMaps) -> None:
        """Move all particles by the correction of the best one's path [u, 3], and give all the map drawn along it."""
        last = self.best_pose
        self.history.revise(self.history.path(self.best), path)
        self.poses = se2.compose(path[-1], se2.between(last, self.poses))
        self.hypotheses[:] = 0
        self.maps = drawn
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


def _rank_at_place(path: Array) -> NDArray[np.intp]:
    """How many poses before it [u] each of a path [u, 3] has in its square of ``PLACE`` and its sector."""
    _, places = np.unique(np.floor(path / PLACE), axis=0, return_inverse=True)
    order = np.argsort(places.ravel(), kind="stable")
    begins = np.flatnonzero(np.diff(places.ravel()[order], prepend=-1))
    ranks = np.empty(len(path), np.intp)
    ranks[order] = np.arange(len(path)) - np.repeat(begins, np.diff(begins, append=len(path)))
    return ranks
