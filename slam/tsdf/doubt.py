"""Whether the robot is lost: scans that stop to fit from one to the next, and go on not to.

While the filter doubts it leaves the scans out of its maps: else they would fit again soon, wherever the robot is.
"""

from __future__ import annotations

from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.filter.misfit import DOUBTFUL_DROP, LOST_DROP, Scores

PROBATION, LEAST_SCANS = 1.0, 3
"""The robot is lost when no scan has fitted for this path [m], and as many have not: people who stand in the way are
passed by then."""

LEAST_KNOWN = 0.5
"""Scans of whose points the map knows less in the mean are of a place that is new, and no sign of a lost robot."""


class Doubt:
    """Watches the match scores of one map.

    A scan whose score is ``LOST_DROP`` standard deviations below the usual, and below that of the scan before, is
    doubted: what the robot drives into, and what changes little by little, lowers the scores less suddenly. Those that
    follow are as long as they are ``DOUBTFUL_DROP`` below. Where the map knows less than half of them the place
    is new and the doubt ends: left out of the map, those that follow would fit no better.

    Attributes:
        state: as the scans until now have it; once lost it stays so.
    """

    def __init__(self) -> None:
        self.state = LocalisationState.SURE
        self._scores, self._before = Scores(), 0.0
        # scans that have not fitted in a row, the sum of what is known of them, and path since the first [m]
        self._scans, self._known, self._path = 0, 0.0, 0.0

    def look(self, driven: float, score: float | None, *, known: float = 1.0) -> None:
        """Take in a scan.

        Args:
            driven: since the scan before [m].
            score: its match score, as a share of the points where the map is known; None where it was not matched.
            known: the share of its points that the map knows something of.
        """
        if self._scans:
            self._path += driven
        if score is None or self.state is LocalisationState.LOST:
            return
        spread, below = self._scores.spread, self._scores.below(score)
        sudden = min(below, self._before - score) > LOST_DROP * spread
        self._before = score
        if below > DOUBTFUL_DROP * spread and (sudden or self._scans):
            self._scans, self._known = self._scans + 1, self._known + known
            if self._scans < LEAST_SCANS or self._path < PROBATION:
                self.state = LocalisationState.DOUBTFUL
                return
            if self._known >= LEAST_KNOWN * self._scans:
                self.state = LocalisationState.LOST
                return
        self._scans, self._known, self._path, self.state = 0, 0.0, 0.0, LocalisationState.SURE
        self._scores.take_in(driven, score)
