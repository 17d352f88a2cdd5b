"""A lost robot: it draws a map of its own from there on, and is looked for in the whole of the one that it had.

The scans of the latest metres together are searched for on a lattice over all places where the robot has been and all
headings, and registered from the best of them; a place counts that has no rival and that the scans do not contradict as
they do where a robot is lost, and only if later searches, after a gap one of other scans, find it at the same place.
"""

import numpy as np

from moteslam.kernels.correlative import MAX_SEARCH_POINTS
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.registration.config import RegistrationConfig, SearchConfig
from moteslam.slam.registration.localisation import BENT
from moteslam.slam.registration.registrar import Points, Registration, register, subsample
from moteslam.slam.registration.search import Window, candidates, is_elsewhere, runner_up, shares
from moteslam.slam.tsdf.doubt import FAR_WHERE_LOST, LEAST_FAR, log_ratio

QUERY = 4.0  # Path of the scans that are searched for together [m]
FIRST_LOOK, APART = 2.0, 1.0
"""The first search is made after this path, and those after it this far apart [m]: further, where they are dear."""
ENDPOINTS_PER_METRE = 4e8  # That all searches look up at most for every metre driven: 0.4 s of one processor
MARGIN = 1.0  # The robot is looked for this far beyond the path on which the map was made [m]
FIRST_WINDOW, FIRST_SHARE = np.array([10.0, 10.0, 0.5]), 0.7
"""A robot that nobody carried has drifted: it is looked for within this of where it was tracked to [m, m, rad] first,
and taken to be there if this share of the endpoints is on surfaces: a place elsewhere could hardly have more."""
STEP, TURN = 0.2, 0.06  # Of the lattice: a basin of Gauss-Newton [m], [rad]
STARTS, START_POINTS, FINALISTS = 60, 120, 12  # Places that are registered with some endpoints, and of these with all
LEAST_SHARE, LEAST_MARGIN = 0.3, 0.1
"""Share of the endpoints on surfaces, less what crosses surfaces, and how much less a place elsewhere has."""
NEAR_DISTANCE, NEAR_ROTATION = 5.0, 0.5
"""Places this far from where the robot was tracked to [m], [rad] need that margin over those beyond only once, these
over them twice: a robot that comes back to a map by much drift looks lost, too."""


class Relocation:
    """Looks for the robot in the map, made on a path [u, 3], that it had before it was lost.

    The new map begins at ``begin`` [3], which is off by ``reach`` at most [m].
    """

    def __init__(
        self,
        maps: TsdfMaps,
        particle: int,
        path: Array,
        config: RegistrationConfig,
        *,
        begin: Array,
        reach: float = np.inf,
        carried: bool = False,
    ) -> None:
        self.updates = len(path)  # how many updates the map is of: those since are in the new one
        self._maps, self._particle = maps, particle
        self._config = config.model_copy(update={"residual": BENT})
        self._mapped = path[:, :2].min(axis=0) - MARGIN, path[:, :2].max(axis=0) + MARGIN
        self._begin, self.reach, self._carried = begin[:2], reach, carried
        self._seen: list[tuple[float, Array, Points]] = []  # path, pose and endpoints of the latest updates
        self._driven = 0.0
        self._next, self._next_whole = FIRST_LOOK, FIRST_LOOK
        self._found: Array | None = None  # by the search before: where the new map's frame lies in the old one's
        self._since = 0.0  # the path at the first of the searches that found that place

    def search(self, pose: Array, points: Points) -> Array | None:
        """Take in an update since, at a pose [3] in the new map with endpoints [k, 2], and search if it is time.

        Returns [3] where the new map's frame lies in the old one's, once that is known.
        """
        if self._seen:
            self._driven += float(np.hypot(*(pose - self._seen[-1][1])[:2]))
        self._seen.append((self._driven, pose, points))
        self._seen = [seen for seen in self._seen if seen[0] > self._driven - QUERY]
        if self._driven < self._next:
            return None
        self._next = self._driven + APART
        drifted = not self._carried and self.reach == np.inf
        place, share = self._search(pose, pose, FIRST_WINDOW) if drifted else (None, 0.0)
        if share < FIRST_SHARE:
            # the lowest and the highest x and y that the robot may have in the old map
            within, (low, high) = self.reach + self._driven, self._mapped
            low, high = np.maximum(low, self._begin - within), np.minimum(high, self._begin + within)
            half = np.array([*np.maximum(high - low, 0.0) / 2, np.pi])
            metres = Window(half, STEP, TURN).places * MAX_SEARCH_POINTS / ENDPOINTS_PER_METRE
            if self._driven < max(self._next_whole, metres if drifted else 0.0):
                return None
            self._next_whole = self._driven + metres
            place, _ = self._search(pose, np.array([*(low + high) / 2, 0.0]), half) if half[:2].all() else (None, 0.0)
        if place is None:
            self._found = None
            return None
        if self._found is None or is_elsewhere(se2.between(se2.compose(self._found, pose), place)):
            self._since = self._driven
        self._found = se2.compose(place, se2.between(pose, np.zeros(3)))
        # after a gap it may well be where it never was, and look-alike places fit the same scans again and again
        enough = self._driven - self._since >= (APART if self.reach == np.inf else QUERY)
        return self._found if enough else None

    def revise(self, drawn: TsdfMaps) -> None:
        """Look in the old map as it was drawn anew."""
        self._maps, self._particle, self._found = drawn, 0, None

    def _search(self, pose: Array, middle: Array, half: Array) -> tuple[Array | None, float]:
        """Where in the old map the robot at a pose [3] of the new one is, in a window [3] of half widths [3].

        Returns [3] and the share of the endpoints there; None and 0 where no place is sure.
        """
        points = np.concatenate([_seen_from(pose, at, scan) for _, at, scan in self._seen])
        if not len(points):
            return None, 0.0
        view, few = self._maps.of(self._particle), subsample(points, START_POINTS)
        lattice = SearchConfig(search_prior=1e-6)
        starts = candidates(view, middle, half, few, Window(half, STEP, TURN), STARTS, lattice)
        tried = self._registered(few, starts, middle, half)
        finalists = np.argsort(-shares(tried, len(few)), kind="stable")[:FINALISTS]
        found = self._registered(points, tried.offsets[finalists], middle, half)
        off = se2.between(se2.between(middle, pose), found.offsets)
        near = (np.hypot(off[:, 0], off[:, 1]) < NEAR_DISTANCE) & (np.abs(off[:, 2]) < NEAR_ROTATION)
        places = shares(found, len(points)) - np.where(near | self._carried, 0.0, LEAST_MARGIN)
        best = int(places.argmax())
        unlike = log_ratio(found.far[best], found.known[best], FAR_WHERE_LOST, LEAST_FAR) > 0  # lost there, too
        rivalled = places[best] - runner_up(found, places, len(points)) < LEAST_MARGIN
        if places[best] < LEAST_SHARE or rivalled or unlike:
            return None, 0.0
        return se2.compose(middle, found.offsets[best]), float(places[best])

    def _registered(self, points: Points, starts: Array, middle: Array, half: Array) -> Registration:
        """Endpoints registered from many starts, as offsets from the middle, free of any prediction."""
        many = np.repeat(middle[None], len(starts), axis=0)
        return register(self._maps.of(self._particle), many, 3 * half, points, np.zeros(2), starts, self._config)


def _seen_from(pose: Array, at: Array, points: Points) -> Points:
    """Endpoints [k, 2] of a scan taken at one pose, in the frame of another."""
    x, y, theta = se2.between(pose, at)
    cos, sin = np.cos(theta), np.sin(theta)
    return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]) + (x, y), np.float32)
