"""Whether the scans still fit the map as they did: a robot that is lost sees another place than its map shows.

The match score of a scan is compared with those along the path before, in their own standard deviations: what is usual
in a calm room and among people differs. A sudden drop marks a place from which on the robot may be lost: soon after,
the filter has written the new scans into its map, and they fit again, wherever they are. So a drop counts until the
map around the robot holds nothing from before it, or the scans fit as well as before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from moteslam.robot.se2 import Array, Pose
from moteslam.slam.filter.certainty import NEIGHBOURHOOD, LocalisationState

DOUBTFUL_DROP, LOST_DROP = 3.5, 6.0
"""A scan whose score is below the mean by this many standard deviations is doubtful, or lost. Chosen on simulated
drives of seeds from 200 on, with and without robots that were carried off (docs/theory/am-i-lost.md)."""
LEAST_SPREAD = 0.05  # The least standard deviation, and the first, which counts like `FIRST_PATH` of path; likewise
FIRST_PATH = 10.0  # See `LEAST_SPREAD` [m]
WRONG_IF_DOUBTFUL, WRONG_IF_LOST = 0.3, 0.75
"""Probability of a wrong pose: of the scans called lost three of four were wrong, over all scenarios."""


class Scores:
    """What match scores are usual: their mean along the last ``NEIGHBOURHOOD`` of path, their spread along it all."""

    def __init__(self) -> None:
        self.mean = 0.0  # so far
        self._scans = 0  # that it is of
        self._variance, self._path = LEAST_SPREAD**2, FIRST_PATH  # of the scores about it, along all the path

    @property
    def spread(self) -> float:
        """Standard deviation of the scores about their mean."""
        return max(math.sqrt(self._variance), LEAST_SPREAD)

    def below(self, score: float) -> float:
        """How far a score is below the mean; 0 for the first."""
        return self.mean - score if self._scans else 0.0

    def take_in(self, driven: float, score: float) -> None:
        """Take in the next score, of a scan driven so far after the one before [m]."""
        step, below = min(driven, NEIGHBOURHOOD), self.below(score)
        self._path += step
        self._variance += step / self._path * (below * below - self._variance)
        self._scans += 1
        self.mean += max(1 / self._scans, step / NEIGHBOURHOOD) * (score - self.mean)


@dataclass
class _Drop:
    """A scan that did not fit, and how those since did."""

    usual: float  # mean score before, less a standard deviation: what counts as fitting again
    before: Array  # [u, 2] places of the updates before
    path: float = 0.0  # driven since [m]
    matched: float = 0.0  # part of that to scans that were used [m]
    fit: float = 0.0  # sum of their scores, each times the distance that it was driven over [m]

    def over(self, x: float, y: float) -> bool:
        """Whether the scans since fit as well as those before, or nothing around the robot is from before."""
        if self.path <= NEIGHBOURHOOD:
            return False
        if self.matched > 0 and self.fit >= self.usual * self.matched:
            return True
        return not (np.hypot(self.before[:, 0] - x, self.before[:, 1] - y) <= NEIGHBOURHOOD).any()


class Misfit:
    def __init__(self) -> None:
        self._scores = Scores()
        self._places: list[tuple[float, float]] = []  # of the updates
        self._lost: _Drop | None = None
        self._doubtful: float | None = None  # path since [m]

    @property
    def state(self) -> LocalisationState:
        if self._lost is not None:
            return LocalisationState.LOST
        return LocalisationState.SURE if self._doubtful is None else LocalisationState.DOUBTFUL

    @property
    def probability(self) -> float:
        """That the pose is wrong, by that state."""
        return (0.0, WRONG_IF_DOUBTFUL, WRONG_IF_LOST)[self.state]

    def observe(self, driven: float, score: float | None) -> None:
        """Take in a scan, driven so far after the one before [m].

        The score is a share of the points where the map is known; None if the scan was not matched.
        """
        if self._lost is not None:
            self._lost.path += driven
        if self._doubtful is not None:
            self._doubtful += driven
            if self._doubtful > NEIGHBOURHOOD:
                self._doubtful = None
        if score is not None:
            self._compare(driven, score)

    def update(self, pose: Pose) -> None:
        x, y, _ = pose
        self._places.append((x, y))
        if self._lost is not None and self._lost.over(x, y):
            self._lost = None

    def revise(self, poses: Array) -> None:
        """Take in corrected poses [u, 3] of all updates."""
        self._places = [(x, y) for x, y, _ in poses.tolist()]
        if self._lost is not None:
            self._lost.before = poses[: len(self._lost.before), :2].copy()

    def _compare(self, driven: float, score: float) -> None:
        """Compare a score with those before, and take it in among them."""
        spread, below = self._scores.spread, self._scores.below(score)
        if below > LOST_DROP * spread:
            usual = self._scores.mean - spread if self._lost is None else self._lost.usual
            self._lost = _Drop(usual, np.array(self._places).reshape(-1, 2))
        elif below > DOUBTFUL_DROP * spread:
            self._doubtful = 0.0
        self._scores.take_in(driven, score)
        if self._lost is not None:
            self._lost.matched += driven
            self._lost.fit += score * driven
