"""Whether the scans still fit the map as they did: a robot that is lost sees another place than its map shows.

The match score a point is compared with its own mean along the path. A sudden drop marks a place from which on the
robot may be lost: soon after, the filter has written the new scans into its map, and they fit again, wherever they
are. So a drop counts until the map around the robot holds nothing from before it, or the scans fit as well as before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.filter.certainty import NEIGHBOURHOOD, LocalisationState

Array = NDArray[np.float64]

DOUBTFUL_DROP, LOST_DROP = 0.2, 0.4
"""A scan whose match score a point is smaller than the mean by these is doubtful, or lost. Chosen on simulated drives
of seeds from 200 on, with and without robots that were carried off (docs/theory/am-i-lost.md)."""


@dataclass
class _Drop:
    """What is known since the scans stopped fitting.

    Attributes:
        usual: mean score before.
        updates: number of updates before.
        path: driven since [m].
        fit: sum of the scores since, each times the distance that it was driven over [m].
    """

    usual: float
    updates: int
    path: float = 0.0
    fit: float = 0.0


class Misfit:
    """Watches the match scores of one run."""

    def __init__(self) -> None:
        self._usual = 0.0  # mean score along the last NEIGHBOURHOOD of path
        self._scans = 0  # that it is of
        self._places: list[tuple[float, float]] = []  # of the updates
        self._lost: _Drop | None = None
        self._doubtful: _Drop | None = None

    @property
    def state(self) -> LocalisationState:
        """As the scans until now have it."""
        if self._lost is not None:
            return LocalisationState.LOST
        return LocalisationState.SURE if self._doubtful is None else LocalisationState.DOUBTFUL

    def look(self, driven: float, score: float | None, *, left_out: bool = False) -> None:
        """Take in a scan.

        Args:
            driven: since the scan before [m].
            score: its match score a point; None where it was not matched.
            left_out: it contradicts the map and was not used.
        """
        for drop in (self._lost, self._doubtful):
            if drop is not None:
                drop.path += driven
        if score is not None:
            self._compare(driven, score, left_out=left_out)
        if self._doubtful is not None and self._doubtful.path > NEIGHBOURHOOD:
            self._doubtful = None

    def update(self, pose: Array) -> None:
        """Take in the pose [3] of an update."""
        x, y, _ = pose.tolist()
        self._places.append((x, y))
        if self._lost is not None and self._lost.path > NEIGHBOURHOOD and self._over(self._lost):
            self._lost = None

    def revise(self, poses: Array) -> None:
        """Take in corrected poses [u, 3] of all updates."""
        self._places = [(x, y) for x, y, _ in poses.tolist()]

    def _compare(self, driven: float, score: float, *, left_out: bool) -> None:
        """Compare a score with the mean, and let the mean follow."""
        below = self._usual - score if self._scans else 0.0
        if below > LOST_DROP:
            usual = self._usual if self._lost is None else self._lost.usual
            self._lost = _Drop(usual, len(self._places))
        elif below > DOUBTFUL_DROP:
            self._doubtful = _Drop(self._usual, len(self._places))
        if left_out:
            return
        self._scans += 1
        self._usual += max(1 / self._scans, min(driven / NEIGHBOURHOOD, 1.0)) * (score - self._usual)
        if self._lost is not None:
            self._lost.fit += score * driven

    def _over(self, drop: _Drop) -> bool:
        """Whether the scans since fit as well as those before, or nothing around the robot is from before."""
        if drop.fit >= drop.usual * drop.path:
            return True
        x, y = self._places[-1]
        before = np.array(self._places[: drop.updates])
        return not bool((np.hypot(before[:, 0] - x, before[:, 1] - y) <= NEIGHBOURHOOD).any())
