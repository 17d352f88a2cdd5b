"""The paths of the particles: poses and parents at every update, followed back from any particle."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array

Indices = NDArray[np.int64]
LONGEST = 128  # Updates of a part


class _Part:
    """Some updates in a row, between which no particles were drawn anew."""

    def __init__(self, begin: int, parents: Indices) -> None:
        self.begin = begin  # the first update
        self.kept = np.arange(len(parents))  # [k] which particles of its updates are kept ...
        self.parents = parents  # ... and where they descend from [k], among those that the part before has kept
        self.room = np.empty((LONGEST, len(parents), 3))  # for the poses of all; none once some are kept alone
        self.poses = self.room[:0]  # [updates, k, 3]

    def keep(self, places: Indices) -> None:
        """Keep some of the particles alone: nothing more is added."""
        self.poses, self.room = self.poses[:, places], np.empty((0, 0, 3))  # not a view, which would hold all of it
        self.kept, self.parents = self.kept[places], self.parents[places]


class History:
    """Grows by one entry an update; a path is read back through the parents that resampling chose.

    Of each update those particles are kept from which some of the last one descend: soon a single one.
    """

    def __init__(self) -> None:
        self.draws = 0  # how often particles were drawn anew
        self._parts: list[_Part] = []
        self._parents: Indices | None = None  # of the next update, where its particles are drawn anew
        self._weights: Array | None = None  # of the last update

    def __len__(self) -> int:
        return self._parts[-1].begin + len(self._parts[-1].poses) if self._parts else 0

    @property
    def particles(self) -> int:
        """How many particles there were at the last update, before its resampling; 0 before the first."""
        return len(self._parts[-1].kept) if self._parts else 0

    @property
    def last(self) -> Array:
        """The poses [N, 3] at the last update, before its resampling."""
        return np.asarray(self._parts[-1].poses[-1])

    def step(self, particle: int) -> Array:
        """The motion [3] of a particle of the last update since the update before; zeros at the first."""
        return se2.between(*self.path(particle, len(self) - 2)) if len(self) > 1 else np.zeros(3)

    @property
    def weighed(self) -> tuple[Array, Array] | None:
        """The poses [N, 3] at the last update with their weights [N], before its resampling; None if not known."""
        return None if self._weights is None else (self.last.copy(), self._weights)

    def append(self, poses: Array, weights: Array | None = None) -> None:
        """Add the poses [N, 3] of an update, before its resampling, and their weights [N]."""
        self._weights = weights
        if not self._parts or self._parents is not None or len(self._parts[-1].poses) == LONGEST:
            self._parts.append(_Part(len(self), np.arange(len(poses)) if self._parents is None else self._parents))
            self._parents = None
            for part, before in zip(self._parts[:0:-1], self._parts[-2::-1], strict=False):
                places, part.parents = np.unique(part.parents, return_inverse=True)
                if len(places) == len(before.kept) and not len(before.room):
                    break
                before.keep(places)
        part = self._parts[-1]
        part.poses = part.room[: len(part.poses) + 1]
        part.poses[-1] = poses

    def resampled(self, parents: Indices) -> None:
        """Record that the next update's particles descend from these [M] of the last."""
        self._parents = parents
        self.draws += 1

    def ancestors(self, particles: Indices, first: int = 0) -> Indices:
        """The indices of what particles [K] of the last update descend from, [K, updates from the first on]."""
        ancestors = np.empty((len(particles), len(self) - first), np.int64)
        for update, part, places in self._traced(particles, first):
            ancestors[:, update - first] = part.kept[places]
        return ancestors

    def paths(self, particles: Indices, first: int = 0) -> Array:
        """The paths [K, updates from the first on, 3] that end in particles [K] of the last update, before its
        resampling.
        """
        paths = np.empty((len(particles), len(self) - first, 3))
        for update, part, places in self._traced(particles, first):
            paths[:, update - first] = part.poses[update - part.begin, places]
        return paths

    def path(self, particle: int, first: int = 0) -> Array:
        """The path [updates from the first on, 3] that ends in one particle of the last update."""
        return np.asarray(self.paths(np.array([particle]), first)[0])

    def move(self, first: int, frames: Array) -> None:
        """Move the poses of all updates from the first on by frames [N, 3], one of each particle.

        Each has a path of its own from there on: from where several descend, there are as many poses.
        """
        places = every = np.arange(len(frames))
        for part in reversed(self._parts):
            if not np.array_equal(places, np.arange(len(part.kept))):
                part.keep(places)
            for poses in part.poses[max(first - part.begin, 0) :]:
                poses[:] = se2.compose(frames, poses)
            if part.begin <= first:
                return
            places, part.parents = part.parents, every

    def revise(self, path: Array, revised: Array) -> None:
        """Move all poses by the correction of one particle's path [updates, 3]: each keeps its place relative to that
        path.
        """
        for update, part, _ in self._traced(np.arange(self.particles), 0):
            moved = se2.between(path[update], part.poses[update - part.begin])
            part.poses[update - part.begin] = se2.compose(revised[update], moved)

    def _traced(self, places: Indices, first: int) -> Iterator[tuple[int, _Part, Indices]]:
        """Every update back to the first, its part, and where in that particles [K] of the last descend from."""
        for part in reversed(self._parts):
            for update in reversed(range(max(part.begin, first), part.begin + len(part.poses))):
                yield update, part, places
            if part.begin <= first:
                return
            places = part.parents[places]
