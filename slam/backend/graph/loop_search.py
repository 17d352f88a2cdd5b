"""Looking for one node's surroundings in another node's submap, and what proves that they are the same place.

A submap is the scans of some neighbouring nodes in one TSDF, and as one set of endpoints that is searched for in it.
A query of some metres of path is searched for on a lattice (Olson 2009), the best places are registered, and the best
of these must have enough endpoints on surfaces, no rival half a metre off, and lie within what the relative covariance
allows.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.protocol import LoopCandidate, Verdict
from moteslam.slam.mapping.tsdf import TsdfMaps, TsdfView
from moteslam.slam.registration.config import RegistrationConfig, SearchConfig
from moteslam.slam.registration.registrar import (
    Points,
    Registration,
    keep_odometry,
    measured_information,
    register,
    subsample,
)
from moteslam.slam.registration.search import Window, candidates, runner_up, shares

MAP_NODES, QUERY_NODES = 12, 6  # Of a submap and of a query, at most: where the robot turns many lie close together
SPACING = 0.1  # Endpoints of a query are at least about this far apart [m]
MAX_POINTS = 400  # Endpoints of a query, at most
BETWEEN = 1e4  # Sessions are this far apart along the path [m]: no submap reaches from one into the next
CACHED = 64  # TSDFs of submaps that are kept, those used last: about half a megabyte each, those of wide windows more
RESIDUAL = 0.03  # Standard deviation of endpoints' distances to another submap's surface [m]: both bend a little
FLOOR = np.array([0.02, 0.02, np.radians(0.3)])  # No loop is known better: [m], [m], [rad]
WEAKEST = 1e-3  # Information of a direction that nothing binds [1/m^2]
LEAST_STARTS, STARTS, START_POINTS, FINALISTS = 8, 40, 120, 12
"""Places of the lattice that are registered with some points, at least and at most: as many as basins of Gauss-Newton
fit into the window; and how many of them with all points."""
WIDE, FINE_TURN, COARSE_TURN = 0.1, 0.02, 0.04  # Windows wider than the first [rad] are searched in the coarser steps
MANY, WIDEST_STEP, WIDEST_TURN = 500_000, 0.2, 0.06
"""Windows of more places than the first are searched in steps of a basin of Gauss-Newton [m], [rad]."""
FARTHEST = 4.0
"""A place is nearer to the prediction than this [standard deviations]: of three that are independent one in a thousand
is not."""
NEGLIGIBLE_PRIOR = 1e-6  # Of the lattice: within the window the prediction counts for nothing until the end
WINDOW_DEVIATIONS = 3.0  # The half width of a window, in standard deviations of the prediction
COVERED = 0.5  # Wider windows have longer submaps [m]
LOOSE = 3.0  # Standard deviation of the prediction in the registration [windows]


class Submaps:
    """The submaps around the nodes, built when they are asked for; nodes lie in them as the chain has them."""

    def __init__(self, nodes: Nodes, config: GraphConfig) -> None:
        self._nodes, self._config = nodes, config
        self.poses, self.path = np.zeros((1, 3)), np.zeros(1)  # [n, 3] of the chain; [n] driven up to each [m]
        self._gaps = 0
        self._maps: OrderedDict[tuple[int, int], TsdfMaps] = OrderedDict()

    @property
    def driven(self) -> float:
        """Length of the path [m]."""
        return float(self.path[-1]) - BETWEEN * self._gaps

    def follow(self, steps: Array, gaps: Sequence[int] = ()) -> None:
        """Lay the nodes along the chain anew, by its steps [n - 1, 3], of which ``gaps`` lie between two sessions."""
        self.poses = np.vstack((np.zeros(3), se2.accumulate(steps)))
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        lengths[list(gaps)] = BETWEEN
        self._gaps = len(gaps)
        self.path = np.r_[0.0, np.cumsum(lengths)]
        self.forget()

    def extend(self, step: Array) -> None:
        self.poses = np.vstack((self.poses, se2.compose(self.poses[-1], step)))
        self.path = np.append(self.path, self.path[-1] + np.hypot(*step[:2]))

    def forget(self) -> None:
        """Build the TSDFs anew when they are asked for."""
        self._maps.clear()

    def around(self, node: int, reach: float = 0.0) -> TsdfMaps:
        """The TSDF of the nodes around one, in its frame; longer by ``reach`` to both ends, in whole metres [m]."""
        extra = 2 * int(np.ceil(reach))
        if (node, extra) in self._maps:
            self._maps.move_to_end((node, extra))
        else:
            maps, length = TsdfMaps(self._config.tsdf), self._config.loops.submap_length
            members = self._members(node, length + extra, round(MAP_NODES * (1 + extra / length)))
            poses = se2.between(self.poses[node], self.poses[members])
            maps.draw(poses, [self._nodes.scans[k] for k in members])
            self._maps[node, extra] = maps
            if len(self._maps) > CACHED:
                self._maps.popitem(last=False)
        return self._maps[node, extra]

    def query(self, node: int) -> Points:
        """The endpoints [k, 2] of the nodes around one, in its frame [m]."""
        members = self._members(node, self._config.loops.query_length, QUERY_NODES)
        middle, scans = self.poses[node], self._nodes.scans
        seen = [se2.transform_points(se2.between(middle, self.poses[k]), scans[k].points) for k in members]
        points = np.vstack(seen)
        cells = np.floor(points / SPACING).astype(np.int64)
        _, first = np.unique(cells, axis=0, return_index=True)
        return subsample(points[np.sort(first)].astype(np.float32), MAX_POINTS)

    def _members(self, node: int, length: float, most: int) -> list[int]:
        near = np.flatnonzero(np.abs(self.path - self.path[node]) <= length / 2)
        return [int(k) for k in near if abs(k - node) <= most // 2]


class Loop(NamedTuple):
    """A candidate as searched, and the information [3, 3] of its relative pose.

    It is next to none along a direction that nothing binds.
    """

    candidate: LoopCandidate
    information: Array


class LoopSearch:
    def __init__(self, nodes: Nodes, submaps: Submaps, config: GraphConfig) -> None:
        self._nodes, self._submaps, self._config = nodes, submaps, config
        self._registration = RegistrationConfig(**{**config.registration.model_dump(), "residual": RESIDUAL})
        self._lattice = SearchConfig(search_prior=NEGLIGIBLE_PRIOR)

    def match(self, submap: int, query: int, predicted: Array, covariance: Array) -> Loop | None:
        """Search a query in a submap, None where there is nothing to compare.

        The query's node is ``predicted`` [3] in the frame of the submap's, with a covariance [3, 3] in its own.
        """
        # a place beyond the ends of the submap could be no rival of a wrong one
        half = WINDOW_DEVIATIONS * np.sqrt(covariance.diagonal())
        window = self.window(covariance)
        maps = self._submaps.around(submap, max(float(window.half[0]) - COVERED, 0.0)).of(0)
        points = self._submaps.query(query)
        if not len(points):
            return None
        number = int(np.clip(np.ceil(np.prod(window.half / self._lattice.basin)), LEAST_STARTS, STARTS))
        starts = candidates(maps, predicted, half, points, window, number, self._lattice)
        few = subsample(points, START_POINTS)
        tried = self._register(maps, predicted, half, few, starts)
        finalists = np.argsort(-self._shares(tried, len(few), covariance), kind="stable")[:FINALISTS]
        found = self._register(maps, predicted, half, points, tried.offsets[finalists])
        places = self._shares(found, len(points), covariance)
        best = int(places.argmax())
        second = runner_up(found, places, len(points))
        # along bare walls the prediction is kept, and the loop binds less there
        kept = keep_odometry(found, half / WINDOW_DEVIATIONS, self._registration)
        information = measured_information(kept, best, self._registration, self._config.correlation)
        error = np.linalg.inv(information + WEAKEST * np.eye(3)) + np.diag(np.square(FLOOR))
        candidate = replace(
            self.unsearched(submap, query, predicted, window).candidate,
            found=se2.compose(predicted, kept.offsets[best]),
            share=float(places[best]),
            runner_up=second,
            known=float(found.known[best]) / len(points),
            likelihood=float(found.likelihoods[best]),
            crossed=float(found.crossed[best]) / len(points),
            verdict=self._verdict(float(places[best]), second, found.offsets[best], covariance),
        )
        return Loop(candidate, np.linalg.inv(error))

    def unsearched(self, submap: int, query: int, predicted: Array, window: Window) -> Loop:
        """The candidate of a search that is not made."""
        indices, stamps = self._nodes.indices, self._nodes.stamps
        pair, half = (indices[submap], indices[query]), (float(window.half[0]), float(window.half[2]))
        candidate = LoopCandidate(*pair, (stamps[submap], stamps[query]), predicted, predicted, half)
        return Loop(candidate, WEAKEST * np.eye(3))

    def window(self, covariance: Array) -> Window:
        """What is searched of a prediction of this covariance [3, 3]."""
        turn = FINE_TURN if WINDOW_DEVIATIONS**2 * covariance[2, 2] <= WIDE**2 else COARSE_TURN
        window = Window.of(covariance, WINDOW_DEVIATIONS, 2 * self._config.tsdf.cell_size, turn)
        return window._replace(step=WIDEST_STEP, heading_step=WIDEST_TURN) if window.places > MANY else window

    def _register(self, maps: TsdfView, predicted: Array, half: Array, points: Points, starts: Array) -> Registration:
        many = np.repeat(predicted[None], len(starts), axis=0)
        return register(maps, many, LOOSE * half, points, np.zeros(2), starts, self._registration)

    def _shares(self, found: Registration, points: int, covariance: Array) -> Array:
        """Of the endpoints on surfaces, less what rays through surfaces and the offset from the prediction cost [N].

        The offset costs half its square in standard deviations, in endpoints that err independently: of two places that
        look alike the one nearer to the prediction is meant.
        """
        return shares(found, points, 0.5 * self._config.correlation * squares(found.offsets, covariance))

    def _verdict(self, share: float, runner_up: float, offset: Array, covariance: Array) -> Verdict:
        c = self._config.loops
        if share <= c.least_share:
            return "weak"
        if share - runner_up <= c.least_margin:
            return "ambiguous"
        inside = squares(offset, covariance) <= FARTHEST**2
        return "accepted" if inside else "outside"


def squares(offsets: Array, covariance: Array) -> Array:
    """The squares [...] of offsets [..., 3] of covariances [..., 3, 3], in standard deviations."""
    return np.asarray(np.einsum("...i,...ij,...j->...", offsets, np.linalg.inv(covariance), offsets))
