"""The particles of a run as a picture needs them: their deviations, their spread, and the ancestors that they share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import between
from moteslam.robot.values import Summarised
from moteslam.slam.estimate import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Cloud(Summarised):
    """The particles of a run. The survivors are those of the last update.

    Attributes:
        stamps: [u] of the updates of the filter [s].
        paths: [K, u, 3] of the survivors.
        ancestors: [K, u] index of each path's particle among those of every update.
        spread: [u, 3] standard deviation of all particles after every update: along and across the heading [m], and of
            the heading [rad].
        best: index of the best particle among the survivors.
    """

    stamps: Array
    paths: Array
    ancestors: NDArray[np.int64]
    spread: Array
    best: int = 0

    @classmethod
    def of(cls, estimate: Estimate) -> Cloud:
        """The particles of an estimate; the best one is where the final trajectory ends."""
        end = estimate.trajectory_final.at(estimate.particle_stamps[-1:]).poses[0]
        from_end = between(end, estimate.particle_paths[:, -1])
        best = int(np.hypot(from_end[:, 0], from_end[:, 1]).argmin())
        return cls(
            estimate.particle_stamps,
            estimate.particle_paths,
            estimate.particle_ancestors,
            estimate.particle_spread,
            best,
        )

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def time(self) -> Array:
        """Of the updates [u], from the first [s]."""
        return np.asarray(self.stamps - self.stamps[0])

    @cached_property
    def mean(self) -> Array:
        """The mean [u, 3] of the survivors' paths."""
        x, y = self.paths[..., :2].mean(axis=0).T
        heading = np.arctan2(np.sin(self.paths[..., 2]).mean(axis=0), np.cos(self.paths[..., 2]).mean(axis=0))
        return np.stack((x, y, heading), axis=-1)

    def deviations(self, survivors: NDArray[np.int64]) -> Array:
        """Of survivors [k] from the mean path, [k, u, 3]: along and across its heading [m], of heading [rad]."""
        return between(self.mean, self.paths[survivors])

    @cached_property
    def ancestor_counts(self) -> NDArray[np.int64]:
        """How many particles of every update [u] have survivors among their descendants."""
        ordered = np.sort(self.ancestors, axis=0)
        return np.asarray(1 + np.count_nonzero(np.diff(ordered, axis=0), axis=0))

    @property
    def partings(self) -> NDArray[np.int64]:
        """The updates [p] at which lineages part: the survivors have more ancestors there than one update before."""
        return np.flatnonzero(np.diff(self.ancestor_counts) > 0) + 1
