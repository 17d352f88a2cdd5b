"""Where in a whole map the robot is: every free place and heading is scored, and the best ones get a probability.

All places of a lattice of Gauss-Newton's basin are scored by the coarse level (Olson 2009), none is left out; the best
are registered with all scans of the latest metres. The log-odds of a place against a robot that is not in this map:

    sum over scans of (u m - c) / rho - FINE mean over scans of f / rho - log N

where m endpoints cost u = ``ELSEWHERE`` each of a robot elsewhere, c by what contradicts the map, and f by their
distances to the surface beyond that, in standard deviations; one in rho = ``CORRELATION`` errs independently, and N is
the number of places. f is the same error of the map at every scan, so that it does not add up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
from moteslam.robot import se2
from moteslam.slam.known_map.hypotheses import LEAST
from moteslam.slam.known_map.maps import KnownMaps
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.evidence import CORRELATION
from moteslam.slam.registration.registrar import Registration, prior_spread, register, subsample
from moteslam.slam.registration.search import apart

Array = NDArray[np.float64]
Points = NDArray[np.float32]

STEP, TURN = 0.2, 0.06
"""Of the lattice: a basin of Gauss-Newton [m], [rad]."""
NEAR = 0.2
"""Endpoints nearer to a surface than this count for a place [m]."""
BLOCK = 32
"""Neighbouring places of which the best is kept."""
PROMISING, STARTS, FINALISTS = 2000, 200, 100
"""Blocks whose best places are looked at; places that are registered with some endpoints; of these with all."""
START_POINTS, POINTS = 120, 250
"""Endpoints of a scan that are registered from every start; from every finalist."""
SAME = np.array([0.3, 0.3, 0.1])
"""Starts, and hypotheses, are farther apart than this in one component at least [m, m, rad]."""
WINDOW, APART, TURNED = 10.0, 0.5, 1.0
"""Scans of the latest so many metres count together; one is taken in every so many [m], or after such a turn [rad]."""
OUTLIER, CROSSING = 4.0, 1.0
"""Cost of an endpoint that contradicts the map, ``LOST_DISTANCE`` and more from any surface, or lies where it knows
nothing; and of a ray through a surface [nats]."""
ON_SURFACE = 0.5
"""Mean cost of any other endpoint [nats], as of a normal error."""
ELSEWHERE = 1.4
"""Cost of an endpoint of a robot that is not in the map [nats]: buildings are alike, and three of four endpoints are
nearer than ``LOST_DISTANCE`` to surfaces at the best place of another one. At a place in the map one of which the map
knows nothing contradicts it, too: most of what a robot sees in a map that it drove in is known."""
FINE = 0.3
"""Share of the fine costs that counts: half a cell by which a wall is drawn aside is the same at all of its endpoints.
"""
CROWDED = 0.5
"""Where a larger share of the places that were registered fit about as well as the best one, others may, too."""
IN_MAP = 0.5
"""The robot is in the map, at one of the places found, from this probability on."""


def contradictions(found: Registration, points: int | Array) -> Array:
    """What of a scan contradicts each place [m], counted as far as it errs independently [nats].

    Args:
        found: its registrations.
        points: how many it has; or those that the map knows there, to leave the others out.
    """
    against = found.far + points - found.known
    return np.asarray(((OUTLIER - ON_SURFACE) * against + CROSSING * found.crossed) / CORRELATION)


class Hypotheses(NamedTuple):
    """Where the robot may be at the latest scan.

    Attributes:
        poses: [K, 3] in the map, the most probable first.
        probabilities: [K]; what is left to 1 is that it is at none of them.
        all_found: these are all that count; else so many places look alike that others were left out.
    """

    poses: Array
    probabilities: Array
    all_found: bool


class _Seen(NamedTuple):
    pose: Array
    points: Points
    origin: Array

    def apart(self, pose: Array) -> float:
        """How far off another pose is, as a multiple of what makes scans err independently."""
        x, y, theta = se2.between(self.pose, pose)
        return float(max(np.hypot(x, y) / APART, abs(theta) / TURNED))


class WholeMapSearch:
    """Collects the scans of a robot of which nothing is known but its odometry, and looks for it in the whole map."""

    def __init__(self, maps: KnownMaps, config: RegistrationConfig) -> None:
        self._maps, self._config = maps, config
        self._places = maps.free_places(STEP)
        self._turns = np.arange(-np.pi, np.pi - TURN / 2, TURN)
        self._seen: list[_Seen] = []

    @property
    def places(self) -> int:
        """That are searched: of the lattice, in all headings."""
        return len(self._places) * len(self._turns)

    def begin(self) -> None:
        """Begin anew, in the same map."""
        self._seen = []

    def see(self, pose: Array, points: Points, origin: Array) -> None:
        """Take in a scan [k, 2] from a pose [3] by the odometry; ``origin`` [2] is where its rays start [m]."""
        if not self._seen or self._seen[-1].apart(pose) >= 1:
            self._seen = [*self._seen, _Seen(pose, points, origin)][-int(WINDOW / APART) :]

    def find(self, pose: Array, points: Points, origin: Array) -> Hypotheses:
        """Where the robot may be at a scan; arguments as of ``see``."""
        some = [_Seen(pose, points, origin), *(seen for seen in self._seen if seen.apart(pose) >= 1)]
        seen_from = (se2.transform_points(se2.between(pose, seen.pose), seen.points) for seen in some)
        together = np.concatenate(list(seen_from)).astype(np.float32)
        starts = self._starts(subsample(together, MAX_SEARCH_POINTS))
        tried, odds = self._odds(starts, some[:1], subsample(together, START_POINTS))
        order = np.argsort(-odds, kind="stable")
        best = order[apart(tried[order], FINALISTS + 1, SAME)]
        likely = odds > odds[order[0]] + np.log(LEAST)
        all_found = not likely[best[FINALISTS:]].any() and (len(starts) < STARTS or bool(likely.mean() < CROWDED))
        best = best[:FINALISTS]
        places, odds = self._odds(tried[best], some, subsample(points, POINTS))
        odds -= np.log(self.places)
        order = np.argsort(-odds, kind="stable")
        order = order[apart(places[order], FINALISTS, SAME)]
        weights = np.exp(np.minimum(odds[order], 500.0))
        return Hypotheses(places[order], weights / (1.0 + weights.sum()), all_found)

    def _starts(self, points: Points) -> Array:
        """The most promising places [m, 3] for endpoints [k, 2], best first."""
        view = self._maps.of(0)
        count = -(-len(self._places) // BLOCK) * BLOCK
        middle = self._places.mean(axis=0)
        places = self._places[np.minimum(np.arange(count), len(self._places) - 1)] - middle
        blocks = count // BLOCK
        scores, chosen = search_scans(
            view.tiles,
            view.frames(np.array([[*middle, 0.0]])),
            points,
            self._turns,
            np.zeros(len(self._turns)),
            places,
            np.zeros(count),
            blocks=blocks,
            cell_size=view.config.cell_size,
            near=NEAR / view.config.coarse_truncation,
        )
        few = np.argpartition(-scores[0], min(PROMISING, scores.shape[1] - 1))[:PROMISING]
        few = few[np.lexsort((few, -scores[0, few]))]
        found = np.column_stack((places[chosen[0, few]] + middle, self._turns[few // blocks]))
        return np.asarray(found[apart(found, STARTS, SAME)])

    def _odds(self, starts: Array, scans: list[_Seen], points: Points) -> tuple[Array, Array]:
        """Places [m, 3] registered from starts with endpoints of the latest scan, and their odds by all scans [nats].

        Without the prior of the places.
        """
        wide = np.array([3 * STEP, 3 * STEP, 3 * TURN])
        latest = scans[0]
        view, zeros = self._maps.of(0), np.zeros_like(starts)
        found = register(view, starts, wide, points, latest.origin, zeros, self._config)
        places = np.asarray(se2.compose(starts, found.offsets))
        odds, fine = np.zeros(len(starts)), np.zeros(len(starts))
        for seen in scans:
            back = se2.between(latest.pose, seen.pose)
            some = subsample(seen.points, POINTS)
            if len(some) == 0:
                continue
            drift = prior_spread(self._config, float(np.hypot(*back[:2])), abs(float(back[2])))
            there = np.asarray(se2.compose(places, back))
            fit = register(view, there, drift, some, seen.origin, zeros, self._config, coarse=False)
            against = fit.far + len(some) - fit.known
            here = (ELSEWHERE - ON_SURFACE) * len(some) / CORRELATION - contradictions(fit, len(some))
            odds += here
            fine += (fit.costs - OUTLIER * against - ON_SURFACE * (len(some) - against)) / CORRELATION
        return places, odds - FINE * fine / len(scans)
