"""Where in a whole map the robot is: every free place and heading is scored, and the best ones get a probability.

All places of a lattice of Gauss-Newton's basin are scored by the coarse level (Olson 2009), none is left out; the best
are registered with all scans of the latest metres. The log-odds of a place against a robot that is not in this map:

    sum over scans of (u m - c) / rho - FINE mean over scans of f / rho - log N

where m endpoints cost u = ``ELSEWHERE`` each of a robot elsewhere, c by what contradicts the map, and f by their
distances to the surface beyond that, in standard deviations; one in rho = ``CORRELATION`` errs independently, and N is
the number of places. f is the same error of the map at every scan, so that it does not add up.

A whole path is searched for around several of its places. A corridor looks like the next one for tens of metres. So
every place that some metres of the path fit is followed along the rest, scan by scan, and what the map knows there
speaks for it or against it. A place that others come near to in that is not known.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from moteslam.kernels.correlative import MAX_SEARCH_POINTS, SquareScores
from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.slam.inputs.step import Step
from moteslam.slam.known_map.config import KnownMapConfig
from moteslam.slam.known_map.hypotheses import LEAST
from moteslam.slam.known_map.maps import KnownMaps
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.localisation import CORRELATION
from moteslam.slam.registration.registrar import Points, Registration, prior_spread, register, subsample
from moteslam.slam.registration.search import apart, is_apart, is_elsewhere

STEP, TURN = 0.2, 0.06  # Of the lattice: a basin of Gauss-Newton [m], [rad]
NEAR = 0.2  # Endpoints nearer to a surface than this count for a place [m]
BLOCK = 8  # Neighbouring squares of four places of which the best one is kept
PROMISING, STARTS, FINALISTS = 2000, 200, 100
"""Blocks whose best places are looked at; places that are registered with some endpoints; of these with all, and more
if more are likely."""
START_POINTS, POINTS = 120, 250  # Endpoints of a scan that are registered from every start; from every finalist
SAME = np.array([0.3, 0.3, 0.1])  # Starts, and hypotheses, are farther apart in one component [m, m, rad]
WINDOW, APART, TURNED = 10.0, 0.5, 1.0
"""Scans of the latest so many metres count together; one is taken in every so many [m], or after such a turn [rad]."""
OUTLIER, CROSSING = 4.0, 2.0
"""Cost of an endpoint that contradicts the map, ``LOST_DISTANCE`` and more from any surface, or lies where it knows
nothing; and of a ray through a surface, whether it ended behind it or was answered by nothing [nats]."""
REACH = 5.0  # Surfaces nearer than this answer [m]: from farther away what is dark does so no more
SHORTER, GOLDEN = 0.4, 0.618034
"""Silent rays end up to this share sooner, each by another one (multiples of the golden ratio): a ray is looked up at
few places of its length, between which there is room for a wall."""
ON_SURFACE = 0.5  # Mean cost of any other endpoint [nats], as of a normal error
ELSEWHERE = 1.7
"""Cost of an endpoint of a robot that is not in the map [nats]: buildings are alike, and three of four endpoints are
nearer than ``LOST_DISTANCE`` to surfaces at the best place of another one. At a place in the map one of which the map
knows nothing contradicts it, too: most of what a robot sees in a map that it drove in is known."""
FINE = 0.3  # Share of the fine costs that counts: by half a cell a wall may be drawn aside at all its endpoints
CROWDED = 0.5
"""Where a likely place lies beyond this share of the starts, of which those that look best come first, others may lie
beyond them all."""
AGAIN, SLOWER = 1.0, 1.3  # A search is made again after this path [m], and after one longer by this factor each time
DECIDED = 0.99  # Probability of one place from which on the others are given up
IN_MAP = 0.5  # The robot is in the map, at one of the places found, from this probability on


class Sight(NamedTuple):
    pose: Array  # [3] of the robot, by its odometry or tracked in what it sees
    points: Points  # [k, 2] the scan's endpoints [m]
    origin: Array  # [2] where its rays start [m]
    silent: Points = np.empty((0, 2), np.float32)  # [m, 2] ends of rays that nothing answered [m], see `silent_rays`

    def apart(self, pose: Array) -> float:
        """How far off another pose is, as a multiple of what makes scans err independently."""
        x, y, theta = se2.between(self.pose, pose)
        return float(max(np.hypot(x, y) / APART, abs(theta) / TURNED))


def silent_rays(ends: Points, origin: Array, share: float) -> Points:
    """A share of the rays that nothing answered, with ends [k, 2], from an origin [2] [m]: [m, 2]; they end at
    ``REACH``.

    It is the share of a scan's endpoints that is left, too: as many rays count as one.
    """
    rays = subsample(ends, round(share * len(ends))) - origin
    if not len(rays):
        return np.empty((0, 2), np.float32)
    lengths = np.minimum(REACH / np.hypot(*rays.T), 1.0) * (1 - SHORTER * (np.arange(len(rays)) * GOLDEN % 1))
    return np.asarray(origin + lengths[:, None] * rays, np.float32)


def sight_of(pose: Array, step: Step, scan: ThinnedScan) -> Sight:
    """A step's scan, thinned, seen from a pose by the odometry."""
    share = len(scan.points) / max(len(step.points), 1)
    return Sight(pose, scan.points, step.origin, silent_rays(step.silent(), step.origin, share))


def passed(maps: KnownMaps, poses: Array, rays: Points, origin: Array, config: RegistrationConfig) -> Array:
    """How many rays [n] that nothing answered [m, 2] go through surfaces of the map, from poses [n, 3]."""
    if not len(rays):
        return np.zeros(len(poses))
    held = config.model_copy(update={"iterations": 0})
    return register(maps.of(0), poses, np.ones(3), rays, origin, np.zeros_like(poses), held, coarse=False).crossed


def contradictions(
    maps: KnownMaps, poses: Array, spread: Array, sight: Sight, config: RegistrationConfig
) -> tuple[Registration, Array]:
    """A scan's registrations near poses [n, 3], and what contradicts each place as if every ray erred by itself [nats].

    ``spread``, ``config``: as of ``register``; at most ``POINTS`` endpoints are registered.
    """
    some = subsample(sight.points, POINTS)
    found = register(maps.of(0), poses, spread, some, sight.origin, np.zeros_like(poses), config, coarse=False)
    rays = subsample(sight.silent, round(len(sight.silent) * len(some) / max(len(sight.points), 1)))
    against = found.far + len(some) - found.known
    silent = passed(maps, poses, rays, sight.origin, config)
    return found, np.asarray((OUTLIER - ON_SURFACE) * against + CROSSING * (found.crossed + silent))


class Hypotheses(NamedTuple):
    """Where the robot may be at the latest scan."""

    poses: Array  # [K, 3] in the map, the most probable first
    probabilities: Array  # [K]; what is left to 1 is that it is at none of them
    all_found: bool  # these are all that count; else so many places look alike that others may be left out
    odds: float  # of the first one [nats]
    maps: KnownMaps  # in which they are found


class WholeMapSearch:
    """Collects the scans of a robot of which only the path is known, and looks for it in the whole map."""

    def __init__(
        self, maps: KnownMaps, config: RegistrationConfig, thinner: KnownMaps | None = None, *, after: float = 0.0
    ) -> None:
        self._driven, self._next, self._pause = 0.0, after, AGAIN
        self._thinner = WholeMapSearch(thinner, config) if thinner else None
        self._maps, self._config = maps, config
        view = maps.of(0)
        size = 2 * view.config.cell_size
        cells = max(round(STEP / size), 1)
        self._scores = SquareScores.of(
            view.tiles, apart=cells, cell_size=size, near=NEAR / view.config.coarse_truncation
        )
        self._step = cells * size
        squares, free = maps.free_squares(self._step)
        some = np.minimum(np.arange(-(-len(squares) // BLOCK) * BLOCK), len(squares) - 1)
        self._squares, self._free = squares[some], free[some]
        self._corner = np.array(view.corner)
        self._turns = np.arange(-np.pi, np.pi - TURN / 2, TURN)
        self._log_places = float(np.log(free.sum() * len(self._turns)))  # of all places, in all headings
        self._seen: list[Sight] = []

    def begin(self) -> None:
        self._seen = []

    def drive(self, path: float) -> None:
        self._driven += path

    def is_due(self) -> bool:
        """Whether it is time to search, by what the robot drove since the last time."""
        due = self._driven >= self._next
        if due:
            self._next, self._pause = self._driven + self._pause, self._pause * SLOWER
        return due

    def see(self, sight: Sight) -> None:
        if not self._seen or self._seen[-1].apart(sight.pose) >= 1:
            self._seen = [*self._seen, sight][-int(WINDOW / APART) :]

    def find(self, latest: Sight, near: Array | None = None) -> Hypotheses:
        """Where the robot may be at a scan, in the whole map or at poses [m, 3]; thick walls may be drawn so."""
        some = [latest, *(seen for seen in self._seen if seen.apart(latest.pose) >= 1)]
        found = self._find(some, near)
        if self._thinner is None:
            return found
        other = self._thinner._find(some, near)
        return other if other.odds > found.odds else found

    def elsewhere(self, latest: Sight) -> bool | None:
        """Whether a robot that may have been carried is elsewhere than at a sight's pose, None where that is open.

        To be there is as likely as all other places together: that it is elsewhere must outweigh these.
        """
        found, there = self.find(latest), self.find(latest, latest.pose[None])
        other = is_elsewhere(se2.between(latest.pose, found.poses))
        least = there.odds + self._log_places + np.log(DECIDED / (1 - DECIDED))
        if found.all_found and other[0] and found.odds > least:
            self._next = self._driven
            return True
        return None if not found.all_found or found.probabilities[other].sum() >= 1 - DECIDED else False

    def _find(self, some: list[Sight], starts: Array | None) -> Hypotheses:
        pose, points = some[0].pose, some[0].points
        seen_from = (se2.transform_points(se2.between(pose, seen.pose), seen.points) for seen in some)
        together = np.concatenate(list(seen_from)).astype(np.float32)
        starts = self._starts(subsample(together, MAX_SEARCH_POINTS)) if starts is None else starts
        tried, odds = self._odds(starts, some[:1], subsample(together, START_POINTS))
        order = np.argsort(-odds, kind="stable")
        best = order[apart(tried[order], STARTS, SAME)]
        best = best[: max(FINALISTS, int(_likely(odds[best]).sum()))]
        places, odds = self._odds(tried[best], some, subsample(points, POINTS))
        first = _same(tried[best], tried).argmax(axis=1)  # start that leads there
        last = np.where(_same(places[_likely(odds)], places), first, STARTS).min(axis=1).max()
        odds -= self._log_places
        order = np.argsort(-odds, kind="stable")
        order = order[apart(places[order], len(order), SAME)]
        weights = np.exp(np.minimum(odds[order], 500.0))
        shares = weights / (1.0 + weights.sum())
        all_found = len(starts) < STARTS or bool(last < CROWDED * STARTS)
        return Hypotheses(places[order], shares, all_found, float(odds[order[0]]), self._maps)

    def _starts(self, points: Points) -> Array:
        """The most promising places [m, 3] for endpoints [k, 2], best first."""
        blocks = len(self._squares) // BLOCK
        scores, chosen = (
            found.reshape(-1)
            for found in self._scores.best_of(
                points, self._turns, self._squares - self._corner, self._free, blocks=blocks
            )
        )
        few = np.argpartition(-scores, min(PROMISING, len(scores) - 1))[:PROMISING]
        few = few[np.lexsort((few, -scores[few]))]
        square, place = np.divmod(chosen[few], 4)
        places = self._squares[square] + self._step * np.stack((place % 2, place // 2), axis=1)
        found = np.column_stack((places, self._turns[few // blocks]))
        return np.asarray(found[apart(found, STARTS, SAME)])

    def _odds(self, starts: Array, scans: list[Sight], points: Points) -> tuple[Array, Array]:
        """Places [m, 3] registered from starts with endpoints of the latest scan, and their odds by all scans [nats].

        Without the prior of the places.
        """
        wide = np.array([3 * STEP, 3 * STEP, 3 * TURN])
        latest = scans[0]
        view, zeros = self._maps.of(0), np.zeros_like(starts)
        found = register(view, starts, wide, points, latest.origin, zeros, self._config)
        places = se2.compose(starts, found.offsets)
        odds, fine = np.zeros(len(starts)), np.zeros(len(starts))
        for seen in scans:
            back = se2.between(latest.pose, seen.pose)
            count = min(len(seen.points), POINTS)
            if not count:
                continue
            drift = prior_spread(self._config, float(np.hypot(*back[:2])), abs(float(back[2])))
            there = se2.compose(places, back)
            fit, contradicted = contradictions(self._maps, there, drift, seen, self._config)
            odds += ((ELSEWHERE - ON_SURFACE) * count - contradicted) / CORRELATION
            against = fit.far + count - fit.known
            fine += fit.costs - OUTLIER * against - ON_SURFACE * (count - against)
        return places, odds - FINE * fine / (CORRELATION * len(scans))


def _likely(odds: Array) -> NDArray[np.bool_]:
    """Which places [n] are not much less probable than the best one, by their odds [nats]."""
    return np.asarray(odds > odds.max() + np.log(LEAST))


def _same(some: Array, others: Array) -> NDArray[np.bool_]:
    """Which of places [m, 3] are the same as others [n, 3]: [m, n]."""
    return ~is_apart(some.T[:, :, None] - others.T[:, None], SAME)


SEARCHES_APART, MOST_SEARCHES = 20.0, 20  # Searches along a path are this far apart [m], at least, and at most so many
FOLLOWED = 10  # Places that each finds of which at most so many are followed
PATH_STEP = np.array([0.02, 0.02, 0.005])
"""Standard deviations of a step of the path from scan to scan, in a map that is bent a little [m, m, rad]."""
CORRECTING = 0.7  # A scan corrects the path where so many of its endpoints are known: the rest of a wall pulls aside
KNOWN = 0.9  # What an endpoint on known cells says for a place [nats]: four outweigh one that contradicts it
LEAST_EVIDENCE = 200.0  # Places of less count for nothing [nats]: ten metres of a path through known cells have it
STOOD = 2.0
"""Nearer than this to where a robot stood the map shows all that is seen from there [m]: farther on it shows of a wall
what few rays met."""
CONTRADICTED = 0.1  # A place is none where the map contradicts more: a tenth of the furniture, moved, is half of it
CLEARLY = 0.5  # A place is known where the map contradicts less than this times the share of any other one


class Place(NamedTuple):
    node: int  # the scan of it around which it was searched for
    evidence: float  # of all its scans [nats]
    contradicted: float  # share of the endpoints that the map knows, of scans where a robot stood; 1 without any
    track: Array  # [n, 3] where they lie


def is_same(place: Array, other: Array) -> bool:
    """Whether two poses [3] are one place."""
    return not is_elsewhere(se2.between(place, other))


class Found(NamedTuple):
    """Where in a map a path lies."""

    place: Place | None  # of most evidence; None without any
    decided: bool  # whether the map contradicts it little, and all others clearly more
    answers: int  # it and the others


def find_path(occupancy: Raster, stood: Array, path: Array, scans: Sequence[Points], origin: Array) -> Found:
    """Where in a map, drawn from poses [m, 3], a path [n, 3] in a frame of its own lies.

    The n scans are endpoints [k, 2] in the robot's frame, their rays start at an origin [2] [m].
    """
    config = KnownMapConfig()
    maps, near = KnownMaps(occupancy, config.tsdf), cKDTree(stood[:, :2])
    view, search = maps.of(0), WholeMapSearch(maps, config.registration)

    def followed(node: int, poses: Array) -> list[Place]:
        """Places [m, 3] of a scan, followed along the path to both ends."""
        still = np.zeros_like(poses)
        tracks = np.zeros((len(poses), len(path), 3))
        evidence, known, far = np.zeros((3, len(poses)))
        for way in (range(node, len(path)), range(node - 1, -1, -1)):
            at, last = poses, node
            for k in way:
                points = subsample(scans[k], POINTS)
                at, last = se2.compose(at, se2.between(path[last], path[k])), k
                if len(points):
                    fit = register(view, at, PATH_STEP, points, origin, still, config.registration, coarse=False)
                    corrects = fit.known >= CORRECTING * len(points)
                    at = np.where(corrects[:, None], se2.compose(at, fit.offsets), at)
                    against = (OUTLIER - ON_SURFACE) * fit.far + CROSSING * fit.crossed
                    evidence += (KNOWN * fit.known - against) / CORRELATION
                    here = near.query(at[:, :2])[0] < STOOD
                    known, far = known + here * fit.known, far + here * fit.far
                tracks[:, k] = at
        contradicted = np.where(known > 0, far / np.maximum(known, 1), 1.0)
        return [Place(node, *each) for each in zip(evidence.tolist(), contradicted.tolist(), tracks, strict=True)]

    driven = np.r_[0.0, np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))]
    way = driven[-1]
    some = np.arange(min(WINDOW, way), way + SEARCHES_APART / 2, max(SEARCHES_APART, way / MOST_SEARCHES))
    places: list[Place] = []
    for node in np.unique(np.minimum(np.searchsorted(driven, some), len(path) - 1)).tolist():
        search.begin()
        for k in np.flatnonzero((driven >= driven[node] - WINDOW) & (driven <= driven[node])).tolist():
            search.see(Sight(path[k], scans[k], origin))
        found = search.find(Sight(path[node], scans[node], origin))
        if found.probabilities.sum() > IN_MAP:
            likely = found.poses[found.probabilities > LEAST * found.probabilities[0]][:FOLLOWED]
            places += followed(node, likely)
    places = [place for place in places if place.evidence > LEAST_EVIDENCE]
    best = max(places, key=lambda place: place.evidence, default=None)
    if best is None:
        return Found(None, False, 0)
    others = [place for place in places if is_elsewhere(se2.between(best.track[best.node], place.track[best.node]))]
    decided = all(best.contradicted < CLEARLY * place.contradicted for place in others)
    return Found(best, decided and best.contradicted <= CONTRADICTED, 1 + len(others))
