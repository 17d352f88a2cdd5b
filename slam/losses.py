"""When the robot was lost and found, and which scans belong to the part of the path that began there."""

from __future__ import annotations

from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.values import Issue

Array = NDArray[np.float64]


class Losses:
    """Takes note of a run's losses."""

    def __init__(self) -> None:
        self._stamps: list[float] = []  # when it was lost and found, in turns [s]
        self._parts: list[tuple[int, int]] = []  # the first scan that did not fit, and the first in the map apart

    def look(self, lost: bool, stamp: float, *, doubted_from: int, scan: int) -> None:
        """Take in an update.

        Args:
            lost: whether the robot is.
            stamp: of its scan [s].
            doubted_from: the first scan since the filter was sure of the pose.
            scan: that of the update.
        """
        if lost is (len(self._stamps) % 2 == 1):
            return
        self._stamps.append(stamp)
        if lost:
            self._parts.append((doubted_from, scan))

    def drawn(self, updates: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Of which updates [u] the map is drawn, while the robot is lost: of the longer part.

        Where the two lie relative to each other is not known, and one would be drawn over the other.

        Args:
            updates: [u] indices of their scans.
        """
        if len(self._stamps) % 2 == 0:
            return np.ones(len(updates), np.bool_)
        apart = updates >= self._parts[-1][1]
        return np.asarray(apart == (apart.mean() > 0.5))

    def parted(self, poses: Array, updates: NDArray[np.intp], driven: Array) -> Array:
        """Poses [n, 3] of all scans without the bridge from a part of the path to the next.

        What no longer fitted the map before belongs to what follows, what did to what was before.

        Args:
            poses: of the scans, between those of the updates as if it were one path.
            updates: [u] indices of their scans.
            driven: [n, 3] poses by the motion from scan to scan alone.
        """
        for first, begun in self._parts:
            last = int(updates[updates < first][-1])
            poses[last:first] = se2.compose(poses[last], se2.between(driven[last], driven[last:first]))
            poses[first:begun] = se2.compose(poses[begun], se2.between(driven[begun], driven[first:begun]))
        return poses

    def issues(self) -> tuple[Issue, ...]:
        """Each loss with its times."""
        issues = []
        for begin, end in zip_longest(self._stamps[::2], self._stamps[1::2]):
            text = f"from {begin:.2f} s on the scans do not say where in its map the robot is: it is lost, and a map "
            text += "apart is drawn, " + (
                "to the end: how the two lie is a prediction; the map is that of the longer part"
                if end is None
                else f"until it is found in the one before at {end:.2f} s"
            )
            issues.append(Issue("lost", text))
        return tuple(issues)
