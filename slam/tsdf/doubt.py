"""The probability that the robot is lost, by what its scans contradict in the map around it.

Where a robot stands elsewhere than it thinks endpoints lie off the surfaces of its map by more than a pose may be off.
A map that bends, a door that opens, a room full of chairs lower the match score by as much, but put few endpoints
there. So a drop of the score counts by what contradicts the map beside it.
"""

import math
from typing import NamedTuple

from moteslam.slam.filter.certainty import DOUBTFUL_DROP, LOST_DROP, LocalisationState, Scores, state_of
from moteslam.slam.registration.localisation import CORRELATION

PRIOR = -6.0  # The log-odds that a pose is wrong of which nothing is known: one in 400
FIRST, MOST = 4.0, 1.5
"""Of the first scan that is suspected the evidence is at most the one, and of each after it the other, either way
[nats]: three decide at the earliest. Who walks up to the robot hides half of what it sees, and is passed by then."""
CARRIED = -0.5  # The log-odds where the robot was carried: found within the window of the search, or not
APART = 0.5  # Scans this far apart err independently [m]; of nearer ones each counts by its share of it
FAR_WHERE_LOST, FAR_AT_FIRST, LEAST_FAR = 0.12, 0.03, 0.01
"""Shares of the endpoints that are far from the surface: where a robot is lost, the mean of simulated drives; where it
is not, before it is known what is usual; and then, at least (in the mean of real logs it is 0 to 0.006)."""
CONTRADICTED = 0.05
"""A drop of the score counts in full where this share of the endpoints is far from the surface, or hidden by surfaces
beyond what is usual."""
UNKNOWN_WHERE_LOST, LEAST_UNKNOWN = 0.5, 0.1
"""Shares of the endpoints where the map is unknown: where a robot is lost; and where it is not, at least."""
AHEAD = 0.25  # That may be more by this share for every metre since the scan before that was not suspected [1/m]
AROUND = 1 / math.pi  # Before a doubt begins, by this share for every radian, too: lidars see half a circle [1/rad]
USUAL = 10.0  # What is usual is a mean along the path of this length [m]


class ScanFit(NamedTuple):
    """A scan at its place in the map."""

    score: float  # its match score, as a share of the points where the map is known
    points: float  # how many it has
    known: float  # of these lie where the map is known
    far: float  # of these are `LOST_DISTANCE` or more from the surface
    crossed: float  # rays that pass through a surface of the map


class Doubt:
    """Watches the scans of one map.

    The log-odds of a wrong pose rise and fall from scan to scan by the evidence of each, and never fall below the
    prior: a robot is carried off at any time. The first scan that counts is one whose score drops below what is usual,
    and below the scan before, or of which far more is new: what the robot drives into lowers the scores, and is new,
    little by little. What is usual is learnt while the robot is not doubted.
    """

    grows = True  # the map, with the path; of one that does not, most may be new for long

    def __init__(self) -> None:
        self._log_odds = PRIOR
        self.carried = False  # the robot was, and has not been found since
        self._driven = 0.0  # since the last scan that was not suspected [m]
        self._scores, self._before = Scores(), 0.0
        self._far, self._crossed, self._unknown = FAR_AT_FIRST, 0.0, UNKNOWN_WHERE_LOST  # usual shares of the endpoints

    @property
    def probability(self) -> float:
        """That the pose is wrong, by the scans until now."""
        return 1 / (1 + math.exp(-self._log_odds))

    @property
    def state(self) -> LocalisationState:
        return state_of(self.probability)

    def observe(self, driven: float, scan: ScanFit | None, *, turned: float = 0.0, carried: bool = False) -> None:
        """Take in a scan, None if it was not matched, driven [m] and turned [rad] so far from the one before.

        It was ``carried`` if it was found farther off than the robot can have driven: somebody moved it, and it is only
        found where the scans fit as is usual.
        """
        self._driven += driven
        if scan is None:
            return
        spread, below = self._scores.spread, self._scores.below(scan.score)
        unknown = 1 - scan.known / scan.points
        self.carried |= carried
        if self.carried:
            fits = below <= spread and unknown <= max(self._unknown, LEAST_UNKNOWN)
            evidence = min(driven / APART, 1.0) * (-MOST if fits else MOST)
            if carried:
                evidence = max(CARRIED - self._log_odds, 0.0)
        elif self._log_odds > PRIOR:
            evidence = min(driven / APART, 1.0) * min(max(self._evidence(scan, below / spread), -MOST), MOST)
        else:
            dropped = min(below, self._before - scan.score) > LOST_DROP * spread
            sudden = dropped or (self.grows and self._new(scan, turned) > MOST)
            evidence = min(max(self._evidence(scan, below / spread), 0.0), FIRST) if sudden else 0.0
        self._log_odds = max(self._log_odds + evidence, PRIOR)
        self._before = scan.score
        if self._log_odds == PRIOR:
            self._driven = 0.0
        if self.state is LocalisationState.SURE:
            self.carried = False
            self._scores.take_in(driven, scan.score)
            share = min(driven / USUAL, 1.0)
            self._far += share * (scan.far / max(scan.known, 1.0) - self._far)
            self._crossed += share * (scan.crossed / scan.points - self._crossed)
            self._unknown += share * (unknown - self._unknown)

    def _evidence(self, scan: ScanFit, below: float) -> float:
        """The log-likelihood ratio of a wrong pose against a right one [nats].

        By the endpoints far from the surface, as many as err independently; by the score, ``below`` the usual one [its
        standard deviations], as far as the map is known; and by more endpoints than usual of which nothing is known:
        there a search finds places that contradict nothing.
        """
        far = log_ratio(scan.far, scan.known, FAR_WHERE_LOST, max(self._far, LEAST_FAR))
        contradicted = scan.far / max(scan.known, 1.0) + max(scan.crossed / scan.points - self._crossed, 0.0)
        drop = max(below - DOUBTFUL_DROP, -MOST)
        if drop > 0:
            drop *= min(contradicted / CONTRADICTED, 1.0)
        return far + max(self._new(scan), 0.0) + drop * scan.known / scan.points

    def _new(self, scan: ScanFit, turned: float = 0.0) -> float:
        """The log-likelihood ratio by the endpoints of which nothing is known [nats]."""
        usual = max(self._unknown, LEAST_UNKNOWN) + AHEAD * self._driven + AROUND * turned
        return log_ratio(scan.points - scan.known, scan.points, UNKNOWN_WHERE_LOST, usual)


def log_ratio(some: float, all_: float, where_lost: float, usually: float) -> float:
    """The log-likelihood ratio [nats] of some endpoints among all, by the share of such ones in either case."""
    usually = min(usually, where_lost)
    rest = (all_ - some) * math.log((1 - where_lost) / (1 - usually))
    return (some * math.log(where_lost / usually) + rest) / CORRELATION
