"""The paths of the particles: poses and parents at every update, followed back from any particle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array


class History:
    """Grows by one entry an update; a path is read back through the parents that resampling chose."""

    def __init__(self) -> None:
        self._poses: list[Array] = []
        self._parents: list[NDArray[np.int64] | None] = []
        self._weights: Array | None = None  # of the last update

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def particles(self) -> int:
        """How many particles there were at the last update, before its resampling; 0 before the first."""
        return len(self._poses[-1]) if self._poses else 0

    @property
    def last(self) -> Array:
        """The poses [N, 3] at the last update, before its resampling."""
        return self._poses[-1]

    def step(self, particle: int) -> Array:
        """The motion [3] of a particle of the last update since the update before; zeros at the first."""
        if len(self) < 2:
            return np.zeros(3)
        parents = self._parents[-2]
        parent = particle if parents is None else int(parents[particle])
        return se2.between(self._poses[-2][parent], self._poses[-1][particle])

    @property
    def weighed(self) -> tuple[Array, Array] | None:
        """The poses [N, 3] at the last update with their weights [N], before its resampling; None if not known."""
        return None if self._weights is None else (self.last, self._weights)

    def append(self, poses: Array, weights: Array | None = None) -> None:
        """Add the poses [N, 3] of an update, before its resampling, and their weights [N]."""
        self._weights = weights
        self._poses.append(poses.copy())
        self._parents.append(None)

    def resampled(self, parents: NDArray[np.int64]) -> None:
        """Record that the next update's particles descend from these [M] of the last."""
        self._parents[-1] = parents

    def ancestors(self, particles: NDArray[np.int64], first: int = 0) -> NDArray[np.int64]:
        """The particles that these [K] of the last update descend from: indices [K, updates from the first on]."""
        index = np.asarray(particles)
        ancestors = np.empty((len(index), len(self) - first), np.int64)
        for update in range(len(self) - 1, first - 1, -1):
            parents = self._parents[update]
            if update < len(self) - 1 and parents is not None:
                index = parents[index]
            ancestors[:, update - first] = index
        return ancestors

    def paths(self, particles: NDArray[np.int64], first: int = 0) -> Array:
        """The paths [K, updates from the first on, 3] that end in particles [K] of the last update (before its
        resampling).
        """
        ancestors = self.ancestors(particles, first)
        paths = np.empty((*ancestors.shape, 3))
        for k, poses in enumerate(self._poses[first:]):
            paths[:, k] = poses[ancestors[:, k]]
        return paths

    def path(self, particle: int, first: int = 0) -> Array:
        """The path [updates from the first on, 3] that ends in one particle of the last update."""
        return np.asarray(self.paths(np.array([particle]), first)[0])

    def move(self, first: int, frames: Array) -> None:
        """Move the poses of all updates from the first on by frames [N, 3], one of each particle."""
        for update in range(first, len(self)):
            self._poses[update] = se2.compose(frames, self._poses[update])

    def revise(self, path: Array, revised: Array) -> None:
        """Move all poses by the correction of one particle's path [updates, 3]: each keeps its place relative to that
        path.
        """
        for update, (old, new) in enumerate(zip(path, revised, strict=True)):
            self._poses[update] = se2.compose(new, se2.between(old, self._poses[update]))
